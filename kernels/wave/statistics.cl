/* Running mean and squared deviations of snapshots (Welford 1962), with standard errors and sums.
 *
 *   I = |u|^2 (add_field) or I (add_image);   mean' = mean + (I - mean)/k;
 *   m2' = m2 + (I - mean)(I - mean') per^2        snapshot number k = 1, 2, ..., share = 1/k
 *   standard_error   e = sqrt(m2 scale) unit,   scale = 1/(k (k - 1)),   unit = 1/per
 *   row_sums         s[y] = (sum_x mean[y0 + y, x], sum_x m2[y0 + y, x]) over x0 <= x < x1,
 *                    compensated (Kahan 1965)
 *
 * Mapping: FOR_X of common.cl; row_sums: one item per row. -DROWS, -DDOUBLE: see common.cl.
 */
#include "common.cl"

/* Pointers without `restrict`, with which Oclgrind 21.10 finds no kernel. */
inline void add(__global real *mean, __global real *m2, size_t at, real value, real share, real per)
{
    const real before = value - mean[at];
    const real now = mean[at] + before * share;
    mean[at] = now;
    m2[at] += (before * per) * ((value - now) * per);
}

__kernel void add_field(__global real *restrict mean, __global real *restrict m2,
                        __global const cplx *restrict u, const real share, const real per,
                        const int ny, const int nx)
{
    const size_t row = row_start(0, get_global_id(1), ny, nx);
    FOR_X(x, nx) {
        const cplx v = u[row + x];
        add(mean, m2, row + x, v.x * v.x + v.y * v.y, share, per);
    }
}

__kernel void add_image(__global real *restrict mean, __global real *restrict m2,
                        __global const real *restrict image, const real share, const real per,
                        const int ny, const int nx)
{
    const size_t row = row_start(0, get_global_id(1), ny, nx);
    FOR_X(x, nx)
        add(mean, m2, row + x, image[row + x], share, per);
}

__kernel void standard_error(__global real *restrict out, __global const real *restrict m2,
                             const real scale, const real unit, const int ny,
                             const int nx)
{
    const size_t row = row_start(0, get_global_id(1), ny, nx);
    FOR_X(x, nx)
        out[row + x] = sqrt(m2[row + x] * scale) * unit;
}

__kernel void row_sums(__global real2 *restrict out, __global const real *restrict mean,
                       __global const real *restrict m2, const int y0, const int x0, const int x1,
                       const int rows, const int nx)
{
    const int y = get_global_id(0);
    if (y >= rows)
        return;
    const size_t row = row_start(0, y0 + y, 0, nx);
    real2 sum = (real2)(0, 0), lost = (real2)(0, 0);
    for (int x = x0; x < x1; ++x) {
        const real2 term = (real2)(mean[row + x], m2[row + x]) - lost;
        const real2 next = sum + term;
        lost = (next - sum) - term;
        sum = next;
    }
    out[y] = sum;
}
