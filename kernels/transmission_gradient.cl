/* Gradient of a loss with respect to what multiplies a field, and its moments over the plane.
 *
 *   transmission_gradient   G[y, x] = sum_b conj(u[b, y, x]) g[b, y, x]
 *   row_moments             m[k, y] = sum_x G[y, x] w[x]^k, k = 0 ... ORDER, compensated (Kahan 1965)
 *
 * g: cotangent of u t, dL/dRe + i dL/dIm. With u t in place of u, G is that of log t. w: places along
 * x in a unit in which they are about 1.
 *
 * -DORDER=n   the highest power (row_moments)
 * Mapping: FOR_X of common.cl (transmission_gradient: no batch axis); row_moments: one item a row.
 * -DROWS, -DDOUBLE: see common.cl.
 */
#include "common.cl"

__kernel void transmission_gradient(__global cplx *restrict out, __global const cplx *restrict u,
                                    __global const cplx *restrict g, const int count, const int ny,
                                    const int nx)
{
    const int y = get_global_id(1);
    const size_t row = row_start(0, y, ny, nx);
    FOR_X(x, nx)
        out[row + x] = (cplx)(0);
    for (int b = 0; b < count; ++b) {
        const size_t from = row_start(b, y, ny, nx);
        FOR_X(x, nx) {
            const cplx v = u[from + x];
            out[row + x] += cmul((cplx)(v.x, -v.y), g[from + x]);
        }
    }
}

#ifdef ORDER
__kernel void row_moments(__global cplx *restrict out, __global const cplx *restrict G,
                          __global const real *restrict w, const int ny, const int nx)
{
    const int y = get_global_id(0);
    if (y >= ny)
        return;
    const size_t row = row_start(0, y, ny, nx);
    cplx sum[ORDER + 1], lost[ORDER + 1];
    for (int k = 0; k <= ORDER; ++k)
        sum[k] = lost[k] = (cplx)(0);
    for (int x = 0; x < nx; ++x) {
        cplx value = G[row + x];
        for (int k = 0; k <= ORDER; ++k) {
            const cplx term = value - lost[k];
            const cplx next = sum[k] + term;
            lost[k] = (next - sum[k]) - term;
            sum[k] = next;
            value *= w[x];
        }
    }
    for (int k = 0; k <= ORDER; ++k)
        out[k * ny + y] = sum[k];
}
#endif
