/* Operations for adjoints and gradients of fields, besides the elements.
 *
 *   conjugate        out[b, y, x] = conj(u[b, y, x])
 *   intensity_slope  out[b, y, x] = 2 w[b, y, x] u[b, y, x]        gradient of sum w |u|^2 by u
 *   row_inner        P[b, y]      = sum_x conj(a[b, y, x]) c[b, y, x]    compensated (Kahan 1965)
 *
 * Mapping: FOR_X of common.cl; row_inner: one item per row. out and u may be the same array.
 * -DROWS, -DDOUBLE: see common.cl.
 */
#include "common.cl"

__kernel void conjugate(__global cplx *out, __global const cplx *u, const int ny, const int nx)
{
    const size_t row = row_start(get_global_id(2), get_global_id(1), ny, nx);
    FOR_X(x, nx) {
        const cplx value = u[row + x];
        out[row + x] = (cplx)(value.x, -value.y);
    }
}

__kernel void intensity_slope(__global cplx *out, __global const real *restrict w,
                              __global const cplx *u, const int ny, const int nx)
{
    const size_t row = row_start(get_global_id(2), get_global_id(1), ny, nx);
    FOR_X(x, nx)
        out[row + x] = 2 * w[row + x] * u[row + x];
}

__kernel void row_inner(__global cplx *restrict out, __global const cplx *restrict a,
                        __global const cplx *restrict c, const int ny, const int nx)
{
    const int y = get_global_id(0);
    const int b = get_global_id(1);
    if (y >= ny)
        return;
    const size_t row = row_start(b, y, ny, nx);
    cplx sum = (cplx)(0), lost = (cplx)(0);
    for (int x = 0; x < nx; ++x) {
        const cplx p = a[row + x], q = c[row + x];
        const cplx term = (cplx)(p.x * q.x + p.y * q.y, p.x * q.y - p.y * q.x) - lost;
        const cplx next = sum + term;
        lost = (next - sum) - term;
        sum = next;
    }
    out[(size_t)b * ny + y] = sum;
}
