/* Energy on pixels from samples of the field on a finer lattice: along x, then along y.
 *
 *   pixel_rows     rows[y, p]  = sum_j w[j] |u[y, first_x + step p + j]|^2
 *   pixel_columns  out[y, x] += gain[y % ty, x % tx] sum_j w[j] rows[first_y + step q + j, p],
 *                  y = oy + q, x = ox + p
 *
 * w: the integral of the samples' interpolation over the active width of a pixel, `length` numbers.
 * gain: one number (ty = tx = 1), or one for each pixel of a tile that repeats over the sensor.
 * Mapping: FOR_X of common.cl. -DROWS, -DDOUBLE: see common.cl.
 */
#include "common.cl"

__kernel void pixel_rows(__global real *restrict rows, __global const cplx *restrict u,
                         __global const real *restrict w, const int length, const int first,
                         const int step, const int number, const int ny, const int nx, const int across)
{
    const int y = get_global_id(1);
    const size_t from = row_start(number, y, ny, nx) + first;
    FOR_X(p, across) {
        real sum = 0;
        for (int j = 0; j < length; ++j) {
            const cplx v = u[from + (size_t)step * p + j];
            sum += w[j] * (v.x * v.x + v.y * v.y);
        }
        rows[(size_t)y * across + p] = sum;
    }
}

__kernel void pixel_columns(__global real *restrict out, __global const real *restrict rows,
                            __global const real *restrict w, const int length, const int first,
                            const int step, __global const real *restrict gain, const int ty,
                            const int tx, const int oy, const int ox, const int out_nx,
                            const int down, const int across)
{
    const int q = get_global_id(1);
    const size_t to = (size_t)(oy + q) * out_nx + ox;
    FOR_X(p, across) {
        real sum = 0;
        for (int j = 0; j < length; ++j)
            sum += w[j] * rows[(size_t)(first + step * q + j) * across + p];
        out[to + p] += gain[(oy + q) % ty * tx + (ox + p) % tx] * sum;
    }
}
