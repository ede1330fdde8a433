/* The sum of many plane waves on a grid.
 *
 *   u[y, x] = sum_p a_p exp(2 pi i (fy_p y + fx_p x))
 *
 * It is a matrix product of tables in double precision on the host. Along x they are centred on the
 * row, so that a cosine and a sine serve two samples, m on either side:
 *
 *   C[y, k] = sum_p rows[y, p] cos(2 pi fx_p x_k),  S[y, k] = sum_p rows[y, p] sin(2 pi fx_p x_k)
 *   u[y, nx/2 + k] = C + i S,  u[y, (nx - 1)/2 - k] = C - i S,  0 <= k < m = (nx + 1)/2
 *
 * rows: a_p exp(2 pi i (fy_p y + fx_p middle)), by blocks: [y / HEIGHT][p][y % HEIGHT]; columns:
 * (cos, sin), by blocks: [k / WIDTH][p][2][k % WIDTH], WIDTH = LANES VECTORS. Both are padded with 0.
 *
 * An item computes a block of HEIGHT rows and WIDTH of the m columns in registers. With -DROWS axis
 * 0 = blocks of rows, so that the next item has its columns in the cache (CPUs); else axis 0 =
 * blocks of columns (GPUs).
 *
 * -DLANES=1 | 4 | 8 | 16, -DVECTORS=n, -DHEIGHT=n   vector type, vectors and rows of an item
 * -DROWS, -DDOUBLE: see common.cl.
 */
#include "common.cl"

#define JOIN_(a, b) a##b
#define JOIN(a, b) JOIN_(a, b)
#define WIDTH (LANES * VECTORS)
#if LANES == 1
typedef real vec;
#elif defined(DOUBLE)
typedef JOIN(double, LANES) vec;
#else
typedef JOIN(float, LANES) vec;
#endif

/* Vector with access to its elements. */
typedef union {
    vec all;
    real one[LANES];
} lanes;

__kernel void plane_waves(__global cplx *restrict u, __global const cplx *restrict rows,
                          __global const real *restrict columns, const int points, const int ny,
                          const int nx)
{
#ifdef ROWS
    const int down = get_global_id(0), across = get_global_id(1);
#else
    const int down = get_global_id(1), across = get_global_id(0);
#endif
    const int m = (nx + 1) / 2;
    if (across * WIDTH >= m)
        return;
    __global const cplx *row = rows + (size_t)down * points * HEIGHT;
    __global const vec *column =
        (__global const vec *)(columns + (size_t)across * points * 2 * WIDTH);
    vec c_re[HEIGHT][VECTORS], c_im[HEIGHT][VECTORS], s_re[HEIGHT][VECTORS], s_im[HEIGHT][VECTORS];
#pragma unroll
    for (int i = 0; i < HEIGHT; ++i)
#pragma unroll
        for (int j = 0; j < VECTORS; ++j)
            c_re[i][j] = c_im[i][j] = s_re[i][j] = s_im[i][j] = (vec)(0);
    for (int p = 0; p < points; ++p, row += HEIGHT, column += 2 * VECTORS) {
#pragma unroll
        for (int i = 0; i < HEIGHT; ++i) {
            const vec re = (vec)(row[i].x), im = (vec)(row[i].y);
#pragma unroll
            for (int j = 0; j < VECTORS; ++j) {
                const vec c = column[j], s = column[VECTORS + j];
                c_re[i][j] += re * c;
                c_im[i][j] += im * c;
                s_re[i][j] += re * s;
                s_im[i][j] += im * s;
            }
        }
    }
#pragma unroll
    for (int i = 0; i < HEIGHT; ++i) {
        const int y = down * HEIGHT + i;
        if (y >= ny)
            break;
        const size_t first = row_start(0, y, ny, nx);
#pragma unroll
        for (int j = 0; j < VECTORS; ++j) {
            const lanes cr = {c_re[i][j]}, ci = {c_im[i][j]}, sr = {s_re[i][j]}, si = {s_im[i][j]};
            for (int lane = 0; lane < LANES; ++lane) {
                const int k = across * WIDTH + j * LANES + lane;
                if (k >= m)
                    break;
                const cplx c = (cplx)(cr.one[lane], ci.one[lane]);
                const cplx turned = (cplx)(-si.one[lane], sr.one[lane]); /* i S */
                u[first + nx / 2 + k] = c + turned;
                u[first + (nx - 1) / 2 - k] = c - turned;
            }
        }
    }
}
