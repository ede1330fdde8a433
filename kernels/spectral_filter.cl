/* A spectrum times a transfer function of which one quadrant is stored.
 *
 *   u[b, ky, kx] *= H[min(ky, Ly - ky), min(kx, Lx - kx)]
 *
 * Mapping: FOR_X of common.cl over the spectrum, FFT order. -DROWS, -DDOUBLE: see common.cl.
 */
#include "common.cl"

__kernel void filter_spectrum(__global cplx *restrict u, __global const cplx *restrict H,
                              const int ny, const int nx)
{
    const int y = get_global_id(1);
    const size_t row = row_start(get_global_id(2), y, ny, nx);
    const size_t quadrant = (size_t)min(y, ny - y) * (nx / 2 + 1);
    FOR_X(x, nx)
        u[row + x] = cmul(u[row + x], H[quadrant + min(x, nx - x)]);
}
