/* Prior for a small variation in time, in a Richardson-Lucy step (total variation of Rudin, Osher and
 * Fatemi 1992, evaluated at the previous step as by Green 1990):
 *
 *   restrain_time   B[t] = B[t]/(1 - a[t] (p[t] - p[t - 1])),  p[t] = d/sqrt(d^2 + e[t]^2)
 *
 * d = V[t + 1] - V[t], 0 after the last frame. The first frame is compared with the volume `before` if
 * begun = 1, else with none.
 * Mapping: FOR_X of common.cl over (planes, ny, nx). -DROWS: see common.cl.
 */
#include "common.cl"

inline float slope(const float d, const float e)
{
    return d / sqrt(d * d + e * e);
}

__kernel void restrain_time(__global float *restrict B, __global const float *restrict V,
                            __global const float *restrict before, __global const float *restrict a,
                            __global const float *restrict e, const int begun, const int frames,
                            const int planes, const int ny, const int nx)
{
    const int y = get_global_id(1);
    const size_t row = row_start(get_global_id(2), y, ny, nx), next = (size_t)planes * ny * nx;
    FOR_X(x, nx) {
        float here = V[row + x];
        float last = begun ? slope(here - before[row + x], e[0]) : 0.0f;
        for (int t = 0; t < frames; ++t) {
            const size_t at = t * next + row + x;
            const float after = t + 1 < frames ? V[at + next] : here;
            const float own = slope(after - here, e[t]);
            B[at] /= 1 - a[t] * (own - last);
            last = own;
            here = after;
        }
    }
}
