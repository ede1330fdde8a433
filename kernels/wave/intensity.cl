/* Intensity of a complex field, its sum and accumulation, and accumulation of real pictures.
 *
 *   intensity    I[b, y, x]  = |u[b, y, x]|^2
 *   accumulate   I[y, x]    += sum_b w[b] |u[b, y, x]|^2     mutually incoherent fields
 *   add_scaled   I[y, x]    += w J[y, x]
 *   row_power    P[b, y]     = sum_x |u[b, y, x]|^2          compensated (Kahan 1965)
 *
 * Mapping: FOR_X of common.cl (accumulate, add_scaled: no batch axis); row_power: one item per row.
 * -DROWS, -DDOUBLE: see common.cl.
 */
#include "common.cl"

inline real norm2(cplx u)
{
    return u.x * u.x + u.y * u.y;
}

__kernel void intensity(__global real *restrict out, __global const cplx *restrict u,
                        const int ny, const int nx)
{
    const size_t row = row_start(get_global_id(2), get_global_id(1), ny, nx);
    FOR_X(x, nx)
        out[row + x] = norm2(u[row + x]);
}

__kernel void accumulate(__global real *restrict out, __global const cplx *restrict u,
                         __global const real *restrict weight, const int count,
                         const int ny, const int nx)
{
    const int y = get_global_id(1);
    const size_t row = row_start(0, y, ny, nx);
    for (int b = 0; b < count; ++b) {
        const size_t from = row_start(b, y, ny, nx);
        const real w = weight[b];
        FOR_X(x, nx)
            out[row + x] += w * norm2(u[from + x]);
    }
}

__kernel void add_scaled(__global real *restrict out, __global const real *restrict in, const real w,
                         const int ny, const int nx)
{
    const size_t row = row_start(0, get_global_id(1), ny, nx);
    FOR_X(x, nx)
        out[row + x] += w * in[row + x];
}

__kernel void row_power(__global real *restrict out, __global const cplx *restrict u,
                        const int ny, const int nx)
{
    const int y = get_global_id(0);
    const int b = get_global_id(1);
    if (y >= ny)
        return;
    const size_t row = row_start(b, y, ny, nx);
    real sum = 0, lost = 0;
    for (int x = 0; x < nx; ++x) {
        const real term = norm2(u[row + x]) - lost;
        const real next = sum + term;
        lost = (next - sum) - term;
        sum = next;
    }
    out[(size_t)b * ny + y] = sum;
}
