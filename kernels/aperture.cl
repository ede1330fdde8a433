/* A circular aperture, area-weighted: out[b, y, x] = in[b, y, x] (covered fraction of the cell).
 *
 * y, x: coordinates of the samples relative to the centre of the disc.
 * Mapping: FOR_X of common.cl. in and out may be the same array. -DROWS, -DDOUBLE: see common.cl.
 */
#include "coverage.cl"

__kernel void disc(__global cplx *out, __global const cplx *in, __global const real *restrict ys,
                   __global const real *restrict xs, const real R, const real hy, const real hx,
                   const int ny, const int nx)
{
    const int y = get_global_id(1);
    const size_t row = row_start(get_global_id(2), y, ny, nx);
    FOR_X(x, nx)
        out[row + x] = in[row + x] * disc_coverage(-xs[x], -ys[y], R, hx, hy);
}
