/* Disparity refined by least squares over the views and over neighbours on one plane.
 *
 *   normal   r_k = S_k(y + d step_y, x + d step_x) - C along the ray, g_k = dr_k/dd; over the group
 *            of views of least cost (matching.cl):
 *            A = mean of w (g - <g>)^2, B = mean of w (g - <g>) (r - <r>),  w = (1 - (e/tau)^2)^2
 *            (Lucas and Kanade 1981; Tukey's weights; means are taken out channel by channel, so
 *            that noise of C, which all views share, moves nothing)
 *   fit      plane a + b_y s + b_x t through d - B/(A + prior) of the neighbours, weights
 *            (A + prior) bell(near (s^2 + t^2) + alike |I - I_0|^2 + level (d - d_0)^2); out = a
 *
 * A step is at most `most`; slopes are held by a ridge. FOR_X over x; linear interpolation of S,
 * clamped at the edges of a view; views that do not see the place do not count.
 * -DCHANNELS=n, -DRADIUS=n; -DROWS: see common.cl
 */
#include "common.cl"

#define GROUPS 9
#define TERMS (5 + 2 * CHANNELS) /* seen, cost, sum w, sum w g^2, sum w g r; w g and w r */

inline float bell(const float q)
{
    const float r = fmax(1 - q * 0.125f, 0.0f);
    const float r2 = r * r;
    const float r4 = r2 * r2;
    return r4 * r4;
}

#ifndef RADIUS
/* Samples of a view at a place inside it, and their slope along `step`. */
inline void along(float *value, float *slope, __global const float *view, const float2 place,
                  const float2 step, const int ny, const int nx)
{
    const int y = min((int)place.x, max(ny - 2, 0)), x = min((int)place.y, max(nx - 2, 0));
    const float fy = place.x - y, fx = place.y - x;
    const int right = nx > 1 ? CHANNELS : 0, down = ny > 1 ? nx * CHANNELS : 0;
    __global const float *q = view + ((size_t)y * nx + x) * CHANNELS;
    for (int c = 0; c < CHANNELS; ++c) {
        const float a = q[c], b = q[c + right], e = q[c + down], f = q[c + down + right];
        const float upper = a + fx * (b - a), lower = e + fx * (f - e);
        value[c] = upper + fy * (lower - upper);
        slope[c] = step.x * (lower - upper) + step.y * ((b - a) + fy * ((f - e) - (b - a)));
    }
}

inline bool inside(const float2 place, const int ny, const int nx)
{
    return place.x >= 0 && place.x <= ny - 1 && place.y >= 0 && place.y <= nx - 1;
}

__kernel void normal(__global float *restrict A, __global float *restrict B,
                     __global const float *restrict S, __global const float *restrict disparity,
                     __global const int *restrict view, __global const float2 *restrict step,
                     __global const int *restrict first, __global const float *restrict pattern,
                     const int patterns, __global const int *restrict reference,
                     __global const float *restrict share, const int references, const float tau,
                     const float ratio, const float margin, const int ny, const int nx)
{
    const int y = get_global_id(1);
    const size_t size = (size_t)ny * nx * CHANNELS;
    FOR_X(x, nx) {
        const size_t i = row_start(0, y, ny, nx) + x;
        const float d = disparity[i];
        const float2 here = (float2)(y, x);
        float centre[CHANNELS], value[CHANNELS], slope[CHANNELS];
        float groups[GROUPS * TERMS], most[GROUPS];
        for (int j = 0; j < GROUPS * TERMS; ++j)
            groups[j] = 0;
        for (int j = 0; j < GROUPS; ++j)
            most[j] = 0;
        for (int c = 0; c < CHANNELS; ++c)
            centre[c] = 0;
        for (int r = 0; r < references; ++r) {
            const int k = reference[r];
            const float2 place = clamp(here + d * step[k], (float2)(0, 0),
                                       (float2)(ny - 1, nx - 1));
            along(value, slope, S + view[k] * size, place, step[k], ny, nx);
            for (int c = 0; c < CHANNELS; ++c)
                centre[c] += share[r] * value[c];
        }
        for (int g = 0; g < patterns; ++g) {
            float terms[TERMS];
            for (int t = 0; t < TERMS; ++t)
                terms[t] = 0;
            for (int k = first[g]; k < first[g + 1]; ++k) {
                const float2 place = here + d * step[k];
                if (!inside(place, ny, nx))
                    continue;
                along(value, slope, S + view[k] * size, place, step[k], ny, nx);
                float e = 0;
                for (int c = 0; c < CHANNELS; ++c) {
                    value[c] -= centre[c];
                    e += fabs(value[c]);
                }
                const float u = fmin(e / tau, 1.0f), w = (1 - u * u) * (1 - u * u);
                terms[0] += 1;
                terms[1] += fmin(e, tau);
                terms[2] += w;
                for (int c = 0; c < CHANNELS; ++c) {
                    terms[3] += w * slope[c] * slope[c];
                    terms[4] += w * slope[c] * value[c];
                    terms[5 + c] += w * slope[c];
                    terms[5 + CHANNELS + c] += w * value[c];
                }
            }
            for (int j = 0; j < GROUPS; ++j) {
                const float w = pattern[g * GROUPS + j];
                most[j] += w * (first[g + 1] - first[g]);
                for (int t = 0; t < TERMS; ++t)
                    groups[j * TERMS + t] += w * terms[t];
            }
        }
        int best = 0;
        float least = groups[0] > 0 ? groups[1] / groups[0] : tau;
        for (int j = 1; j < GROUPS; ++j) {
            const float count = groups[j * TERMS];
            if (count > 0 && count >= 0.5f * most[j]
                && ratio * groups[j * TERMS + 1] / count + margin < least) {
                least = ratio * groups[j * TERMS + 1] / count + margin;
                best = j;
            }
        }
        const float *sum = groups + best * TERMS;
        float a = sum[3], b = sum[4];
        if (sum[2] > 0)
            for (int c = 0; c < CHANNELS; ++c) {
                a -= sum[5 + c] * sum[5 + c] / sum[2];
                b -= sum[5 + c] * sum[5 + CHANNELS + c] / sum[2];
            }
        A[i] = sum[0] > 0 ? fmax(a, 0.0f) / sum[0] : 0.0f;
        B[i] = sum[0] > 0 ? b / sum[0] : 0.0f;
    }
}
#endif

#ifdef RADIUS
__kernel void fit(__global float *restrict out, __global float *restrict weight,
                  __global const float *restrict A, __global const float *restrict B,
                  __global const float *restrict disparity, __global const float *restrict I,
                  __global const float *restrict alike, __global const float *restrict near,
                  __global const float *restrict prior, const float level, const float ridge, const float most,
                  const int ny, const int nx)
{
    const int y = get_global_id(1);
    FOR_X(x, nx) {
        const size_t i = row_start(0, y, ny, nx) + x;
        const float d = disparity[i], same = alike[i], close = near[i], held = prior[i];
        float w0 = 0, wy = 0, wx = 0, wyy = 0, wyx = 0, wxx = 0, v0 = 0, vy = 0, vx = 0, known = 0;
        for (int s = max(-RADIUS, -y); s <= min(RADIUS, ny - 1 - y); ++s)
            for (int t = max(-RADIUS, -x); t <= min(RADIUS, nx - 1 - x); ++t) {
                const size_t k = i + s * nx + t;
                float q = close * (s * s + t * t);
                for (int c = 0; c < CHANNELS; ++c) {
                    const float e = I[k * CHANNELS + c] - I[i * CHANNELS + c];
                    q += e * e * same;
                }
                const float rise = disparity[k] - d;
                const float alone = bell(q + level * rise * rise);
                const float w = alone * (A[k] + held);
                const float v = w * (rise + clamp(-B[k] / (A[k] + held), -most, most));
                known += alone * A[k];
                w0 += w;
                wy += w * s;
                wx += w * t;
                wyy += w * (s * s + ridge);
                wyx += w * s * t;
                wxx += w * (t * t + ridge);
                v0 += v;
                vy += v * s;
                vx += v * t;
            }
        const float c0 = wyy * wxx - wyx * wyx, cy = wx * wyx - wy * wxx, cx = wy * wyx - wx * wyy;
        const float det = w0 * c0 + wy * cy + wx * cx;
        out[i] = d + (det > 1e-6f * w0 * c0 ? (c0 * v0 + cy * vy + cx * vx) / det : v0 / w0);
        weight[i] = known;
    }
}
#endif
