/* Smoothing of every plane of volumes by its own symmetric window, with reflected edges.
 *
 *   down     padded[f, z, y, m + x] = sum_s w[z, |s|] in[f, z, y + s, x],   -m <= x < nx + m
 *   across   out[f, z, y, x] = sum_t w[z, |t|] padded[f, z, y, m + x + t],  abs(s), abs(t) <= r[z]
 *
 * for 0 <= r[z] <= m <= ny, nx. With the reflection d c b a | a b c d the smoothing is self-adjoint.
 * Mapping: FOR_X of common.cl over (frames planes, ny, nx). -DROWS: see common.cl.
 */
#include "common.cl"

inline int reflected(const int i, const int n)
{
    return i < 0 ? -1 - i : i < n ? i : 2 * n - 1 - i;
}

__kernel void down(__global float *restrict padded, __global const float *restrict in,
                   __global const float *restrict w, __global const int *restrict r, const int m,
                   const int planes, const int ny, const int nx)
{
    const int y = get_global_id(1), f = get_global_id(2), z = f % planes;
    __global float *out = padded + row_start(f, y, ny, nx + 2 * m) + m;
    for (int s = -r[z]; s <= r[z]; ++s) {
        const float weight = w[z * (m + 1) + abs(s)];
        const size_t row = row_start(f, reflected(y + s, ny), ny, nx);
        FOR_X(x, nx)
            out[x] = (s > -r[z] ? out[x] : 0) + weight * in[row + x];
    }
    FOR_X(x, nx) {
        if (x < m)
            out[-1 - x] = out[x];
        if (x >= nx - m)
            out[2 * nx - 1 - x] = out[x];
    }
}

__kernel void across(__global float *restrict out, __global const float *restrict padded,
                     __global const float *restrict w, __global const int *restrict r, const int m,
                     const int planes, const int ny, const int nx)
{
    const int y = get_global_id(1), f = get_global_id(2), z = f % planes;
    __global const float *in = padded + row_start(f, y, ny, nx + 2 * m) + m;
    const size_t row = row_start(f, y, ny, nx);
    for (int t = -r[z]; t <= r[z]; ++t) {
        const float weight = w[z * (m + 1) + abs(t)];
        FOR_X(x, nx)
            out[row + x] = (t > -r[z] ? out[row + x] : 0) + weight * in[x + t];
    }
}
