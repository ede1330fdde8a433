/* Conversion of light fields between view positions and directions (thesis, section 1.4.2).
 *
 *   out[j, i, y, x, c] = sum_ab A[y][a] B[x][b] L[v, u, y, x, c] / sum_ab A[y][a] B[x][b]
 *   v = j + first_v[y] + a,   u = i + first_u[x] + b,   a, b = 0 .. 3
 *
 * A ray (x, u) has the direction theta = (x - u)/F, so that a step of theta is one of u and every
 * column is shifted along u by its own constant, and rows along v. Taps of views outside or
 * unlit are excluded from sum and weight; a ray without taps is 0. -DCUBIC: rays with
 * all of their 16 taps take `taps`, the others `linear` (taps 1 and 2 only), as without -DCUBIC.
 *
 * FOR_X over (x, c); get_global_id(1) is y, (2) the view of the result.
 *
 * -DSAMPLE=uchar | ushort | half | float: storage type of the light field. -DROWS: see common.cl.
 */
#include "common.cl"
#include "stored.cl"

inline float part(const float4 taps, const int a)
{
    return a == 0 ? taps.s0 : a == 1 ? taps.s1 : a == 2 ? taps.s2 : taps.s3;
}

__kernel void parametrise(__global float *restrict out, __global const SAMPLE *restrict L,
                          __global const int *restrict lit, __global const int *restrict first_v,
                          __global const float4 *restrict taps_v,
                          __global const float4 *restrict linear_v,
                          __global const int *restrict first_u,
                          __global const float4 *restrict taps_u,
                          __global const float4 *restrict linear_u, const int V, const int U,
                          const int to_U, const int ny, const int nx, const int channels)
{
    const int view = get_global_id(2);
    const int y = get_global_id(1);
    const int v0 = view / to_U + first_v[y];
    const int width = nx * channels;
    const size_t row = row_start(view, y, ny, width);
    FOR_X(s, width) {
        const int x = s / channels;
        const int u0 = view % to_U + first_u[x];
        float sum = 0, used = 0, cubic = 0;
        bool whole = true;
#ifdef CUBIC
        for (int a = 0; a < 4; ++a)
            for (int b = 0; b < 4; ++b) {
#else
        for (int a = 1; a < 3; ++a)
            for (int b = 1; b < 3; ++b) {
#endif
                const int v = v0 + a, u = u0 + b;
                const float w = part(linear_v[y], a) * part(linear_u[x], b);
                const float k = part(taps_v[y], a) * part(taps_u[x], b);
                const bool inside = v >= 0 && v < V && u >= 0 && u < U;
                if (inside && lit[v * U + u]) {
                    const float sample = stored(L, row_start(v * U + u, y, ny, width) + s);
                    sum = mad(w, sample, sum);
                    cubic = mad(k, sample, cubic);
                    used += w;
                } else if (k != 0) {
                    whole = false;
                }
            }
#ifdef CUBIC
        if (whole) {
            out[row + s] = cubic;
            continue;
        }
#endif
        out[row + s] = used > 0 ? sum / used : 0;
    }
}
