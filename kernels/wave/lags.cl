/* Image as a sum over the displacements (lags) within the coherence length.
 *
 *   lag_products   out[b, y, x] = a[y, x] conj(a[(y + sy[b]) mod Ny, (x + sx[b]) mod Nx])
 *   add_products   A[y, x]     += sum_b w[b] T[b, y, x] G[b, y, x]
 *
 * Mapping: FOR_X of common.cl (add_products: no batch axis). -DROWS, -DDOUBLE: see common.cl.
 */
#include "common.cl"

__kernel void lag_products(__global cplx *restrict out, __global const cplx *restrict a,
                           __global const int2 *restrict shift, const int ny, const int nx)
{
    const int y = get_global_id(1);
    const int b = get_global_id(2);
    const int2 by = shift[b];
    const int other = y + by.x;
    const size_t row = row_start(b, y, ny, nx);
    const size_t here = row_start(0, y, ny, nx);
    const size_t there = row_start(0, other < ny ? other : other - ny, ny, nx);
    FOR_X(x, nx) {
        const int from = x + by.y;
        const cplx v = a[there + (from < nx ? from : from - nx)];
        out[row + x] = cmul(a[here + x], (cplx)(v.x, -v.y));
    }
}

__kernel void add_products(__global cplx *restrict A, __global const cplx *restrict T,
                           __global const cplx *restrict G, __global const cplx *restrict weight,
                           const int count, const int ny, const int nx)
{
    const int y = get_global_id(1);
    const size_t row = row_start(0, y, ny, nx);
    for (int b = 0; b < count; ++b) {
        const size_t from = row_start(b, y, ny, nx);
        const cplx w = weight[b];
        FOR_X(x, nx)
            A[row + x] += cmul(w, cmul(T[from + x], G[from + x]));
    }
}
