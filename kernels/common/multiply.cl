/* A batch of fields times one field: out[b, y, x] = in[b, y, x] t[y, x]; and a field added to
 * another: out[b, y, x] += in[b, y, x].
 *
 * Mapping: FOR_X of common.cl. in and out may be the same array. -DCONJUGATE: times conj(t).
 * -DROWS, -DDOUBLE: see common.cl.
 */
#include "common.cl"

#ifdef CONJUGATE
#define FACTOR(t) ((cplx)((t).x, -(t).y))
#else
#define FACTOR(t) (t)
#endif

__kernel void multiply(__global cplx *out, __global const cplx *in, __global const cplx *restrict t,
                       const int ny, const int nx)
{
    const int y = get_global_id(1);
    const size_t row = row_start(get_global_id(2), y, ny, nx);
    const size_t same = row_start(0, y, ny, nx);
    FOR_X(x, nx)
        out[row + x] = cmul(in[row + x], FACTOR(t[same + x]));
}

__kernel void add(__global cplx *restrict out, __global const cplx *restrict in, const int ny,
                  const int nx)
{
    const int y = get_global_id(1);
    const size_t row = row_start(get_global_id(2), y, ny, nx);
    FOR_X(x, nx)
        out[row + x] += in[row + x];
}
