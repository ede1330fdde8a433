/* Gradient of a loss by a factor of a field, and its moments over the plane.
 *
 *   transmission_gradient   G[y, x] = sum_b conj(u[b, y, x]) g[b, y, x]
 *   row_moments             m[k, y] = sum_x G[y, x] w[x]^k, k = 0 ... ORDER, from one reading of u and g,
 *                           eight parallel sums, compensated (Kahan 1965)
 *
 * g: cotangent of u t, dL/dRe + i dL/dIm. With u t in place of u, G is that of log t. w: positions along
 * x in a unit in which they are about 1.
 *
 * -DORDER=n   the highest power (row_moments)
 * Mapping: FOR_X of common.cl (transmission_gradient: no batch axis); row_moments: one item per row.
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
#ifdef DOUBLE
typedef double8 real8;
typedef double16 real16;
#else
typedef float8 real8;
typedef float16 real16;
#endif

/* Eight sums, and their rounding errors. */
typedef struct {
    real8 sum, lost;
} sums;

inline void add(sums *s, real8 value)
{
    const real8 term = value - s->lost;
    const real8 next = s->sum + term;
    s->lost = (next - s->sum) - term;
    s->sum = next;
}

inline real total(real8 s)
{
    const real8 other = s.s45670123, four = s + other;
    const real8 two = four + four.s23016745;
    return two.s0 + two.s1;
}

__kernel void row_moments(__global cplx *restrict out, __global const cplx *restrict u,
                          __global const cplx *restrict g, __global const real *restrict w,
                          const int count, const int ny, const int nx)
{
    const int y = get_global_id(0);
    if (y >= ny)
        return;
    sums re[ORDER + 1], im[ORDER + 1];
    for (int k = 0; k <= ORDER; ++k)
        re[k].sum = re[k].lost = im[k].sum = im[k].lost = (real8)(0);
    for (int b = 0; b < count; ++b) {
        const size_t row = row_start(b, y, ny, nx);
        int x = 0;
        for (; x + 8 <= nx; x += 8) {
            const real16 p = vload16(0, (__global const real *)(u + row + x));
            const real16 q = vload16(0, (__global const real *)(g + row + x));
            const real8 at = vload8(0, w + x);
            real8 along = p.even * q.even + p.odd * q.odd;
            real8 across = p.even * q.odd - p.odd * q.even;
            for (int k = 0; k <= ORDER; ++k) {
                add(&re[k], along);
                add(&im[k], across);
                along *= at;
                across *= at;
            }
        }
        for (; x < nx; ++x) { /* the end of the row */
            const cplx p = u[row + x];
            cplx value = cmul((cplx)(p.x, -p.y), g[row + x]);
            for (int k = 0; k <= ORDER; ++k) {
                add(&re[k], (real8)(value.x, 0, 0, 0, 0, 0, 0, 0));
                add(&im[k], (real8)(value.y, 0, 0, 0, 0, 0, 0, 0));
                value *= w[x];
            }
        }
    }
    for (int k = 0; k <= ORDER; ++k)
        out[k * ny + y] = (cplx)(total(re[k].sum), total(im[k].sum));
}
#endif
