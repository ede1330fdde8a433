/* Disparity refined by least squares over the views and over neighbours on one plane.
 *
 *   normal   r_k = L_k - C on the plane next to the pixel's disparity d, g_k = dr_k/dd; over the
 *            group of views of least cost (matching.cl):
 *            A = mean of w (g - <g>)^2, B = mean of w (g - <g>) (r - <r>) + A (d - plane),
 *            w = (1 - (e/tau)^2)^2
 *            (Lucas and Kanade 1981; Tukey's weights; each channel's mean is subtracted, so
 *            that noise of C, common to all views, has no effect)
 *   fit      plane a + b_y s + b_x t through d - B/(A + prior) of the neighbours, weights
 *            (A + prior) bell(near (s^2 + t^2) + alike |I - I_0|^2 + level (d - d_0)^2); out = a
 *
 * Tables as in matching.cl; slope[p, k]: taps of the derivatives along y and x, step[k]: pixels
 * (y, x) of a view for disparity 1. A step is at most `most`; a ridge regularises slopes.
 * Edges of views are repeated; views that do not see the point are ignored.
 *
 * normal: FOR_X over x, -DSAMPLE=uchar | ushort | half | float; fit: an item is BLOCK pixels of a
 * row, -DRADIUS=n, -DBLOCK=n; both: -DCHANNELS=n; -DROWS: see common.cl
 */
#include "common.cl"
#include "stored.cl"
#include "bell.cl"

#define GROUPS 9
#define TERMS (5 + 2 * CHANNELS) /* seen, cost, sum w, sum w g^2, sum w g r; w g and w r */

#ifdef SAMPLE
/* Samples of a moved view and their derivative by disparity. */
inline void along(float *value, float *slope, __global const SAMPLE *view, const int2 place,
                  const float4 down, const float4 across, const float4 down_slope,
                  const float4 across_slope, const float2 step, const int ny, const int nx)
{
    const int inside = place.x >= 1 && place.x + 2 < ny && place.y >= 1 && place.y + 2 < nx;
    for (int c = 0; c < CHANNELS; ++c) {
        float4 sum = 0, change = 0;
        for (int s = 0; s < 4; ++s) {
            const int y = inside ? place.x + s - 1 : clamp(place.x + s - 1, 0, ny - 1);
            __global const SAMPLE *row = view + (size_t)y * nx * CHANNELS + c;
            float4 samples;
            if (inside) {
                row += (place.y - 1) * CHANNELS;
                samples = (float4)(stored(row, 0), stored(row, CHANNELS), stored(row, 2 * CHANNELS),
                                   stored(row, 3 * CHANNELS));
            } else {
                samples = (float4)(stored(row, clamp(place.y - 1, 0, nx - 1) * CHANNELS),
                                   stored(row, clamp(place.y, 0, nx - 1) * CHANNELS),
                                   stored(row, clamp(place.y + 1, 0, nx - 1) * CHANNELS),
                                   stored(row, clamp(place.y + 2, 0, nx - 1) * CHANNELS));
            }
            const float a = s == 0 ? down.x : s == 1 ? down.y : s == 2 ? down.z : down.w;
            const float b = s == 0   ? down_slope.x
                            : s == 1 ? down_slope.y
                            : s == 2 ? down_slope.z
                                     : down_slope.w;
            sum += a * samples;
            change += b * samples;
        }
        value[c] = dot(across, sum);
        slope[c] = step.x * dot(across, change) + step.y * dot(across_slope, sum);
    }
}

__kernel void normal(__global float *restrict A, __global float *restrict B,
                     __global const SAMPLE *restrict L, __global const uchar *restrict wanted,
                     __global const float *restrict disparity,
                     __global const int *restrict nearest, __global const float *restrict planes,
                     __global const int *restrict view, __global const float2 *restrict step,
                     __global const int2 *restrict at, __global const float4 *restrict part,
                     __global const float4 *restrict slopes, __global const int2 *restrict reach,
                     __global const int *restrict first, __global const float *restrict pattern,
                     const int patterns, __global const int *restrict reference,
                     __global const float *restrict share, const int references, const int views,
                     const int ny, const int nx, const float tau, const float ratio,
                     const float margin)
{
    const int y = get_global_id(1);
    const size_t size = (size_t)ny * nx * CHANNELS;
    FOR_X(x, nx) {
        const size_t i = row_start(0, y, ny, nx) + x;
        if (!wanted[i])
            continue;
        const int table = nearest[i] * views;
        const int2 here = (int2)(y, x);
        float centre[CHANNELS], value[CHANNELS], slope[CHANNELS];
        float groups[GROUPS * TERMS], most[GROUPS];
        for (int j = 0; j < GROUPS * TERMS; ++j)
            groups[j] = 0;
        for (int j = 0; j < GROUPS; ++j)
            most[j] = 0;
        for (int c = 0; c < CHANNELS; ++c)
            centre[c] = 0;
        for (int r = 0; r < references; ++r) {
            const int v = reference[r], k = table + v;
            along(value, slope, L + view[v] * size, here + at[k], part[2 * k], part[2 * k + 1],
                  slopes[2 * k], slopes[2 * k + 1], step[v], ny, nx);
            for (int c = 0; c < CHANNELS; ++c)
                centre[c] += share[r] * value[c];
        }
        for (int g = 0; g < patterns; ++g) {
            float terms[TERMS];
            for (int t = 0; t < TERMS; ++t)
                terms[t] = 0;
            for (int v = first[g]; v < first[g + 1]; ++v) {
                const int k = table + v;
                const int2 place = here + at[k];
                if (place.x < 0 || place.x + reach[k].x >= ny || place.y < 0
                    || place.y + reach[k].y >= nx)
                    continue;
                along(value, slope, L + view[v] * size, place, part[2 * k], part[2 * k + 1],
                      slopes[2 * k], slopes[2 * k + 1], step[v], ny, nx);
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
        a = sum[0] > 0 ? fmax(a, 0.0f) / sum[0] : 0.0f;
        b = sum[0] > 0 ? b / sum[0] : 0.0f;
        A[i] = a;
        B[i] = b + a * (disparity[i] - planes[nearest[i]]);
    }
}
#endif

#ifdef RADIUS
#if BLOCK > 1
__attribute__((reqd_work_group_size(1, 1, 1)))
#endif
__kernel void fit(__global float *restrict out, __global float *restrict known,
                  __global const float *restrict A, __global const float *restrict B,
                  __global const float *restrict disparity, __global const float *restrict I,
                  __global const float *restrict alike, __global const float *restrict near,
                  __global const float *restrict prior, const float level, const float ridge,
                  const float most, const int ny, const int nx)
{
    const int x0 = get_global_id(0) * BLOCK, y = get_global_id(1);
    if (x0 >= nx)
        return;
    const int n = min(BLOCK, nx - x0);
    const size_t i = row_start(0, y, ny, nx) + x0, size = (size_t)ny * nx;
    float same[BLOCK];
    float m[10 * BLOCK]; /* sums of w: 1, s, t, s^2, s t, t^2, v, v s, v t; of information */
    for (int x = 0; x < 10 * BLOCK; ++x)
        m[x] = 0;
    for (int s = max(-RADIUS, -y); s <= min(RADIUS, ny - 1 - y); ++s)
        for (int t = -RADIUS; t <= RADIUS; ++t) {
            const int begin = clamp(-t - x0, 0, n), end = clamp(nx - t - x0, begin, n);
            const float square = s * s + t * t;
            const long k = (long)i + s * nx + t;
            for (int x = begin; x < end; ++x)
                same[x] = 0;
            for (int c = 0; c < CHANNELS; ++c) {
                __global const float *here = I + c * size + i, *there = I + c * size + k;
                for (int x = begin; x < end; ++x) {
                    const float e = there[x] - here[x];
                    same[x] += e * e;
                }
            }
            for (int x = begin; x < end; ++x) {
                const float rise = disparity[k + x] - disparity[i + x];
                const float share = bell(near[i + x] * square + same[x] * alike[i + x]
                                         + level * rise * rise);
                const float a = A[k + x] + prior[k + x];
                const float w = share * a;
                const float v = w * rise + share * clamp(-B[k + x], -most * a, most * a);
                m[x] += w;
                m[BLOCK + x] += w * s;
                m[2 * BLOCK + x] += w * t;
                m[3 * BLOCK + x] += w * (s * s + ridge);
                m[4 * BLOCK + x] += w * (s * t);
                m[5 * BLOCK + x] += w * (t * t + ridge);
                m[6 * BLOCK + x] += v;
                m[7 * BLOCK + x] += v * s;
                m[8 * BLOCK + x] += v * t;
                m[9 * BLOCK + x] += share * A[k + x];
            }
        }
    for (int x = 0; x < n; ++x) {
        const float w = m[x], s = m[BLOCK + x], t = m[2 * BLOCK + x], ss = m[3 * BLOCK + x];
        const float st = m[4 * BLOCK + x], tt = m[5 * BLOCK + x];
        const float c = ss * tt - st * st, cs = t * st - s * tt, ct = s * st - t * ss;
        const float det = w * c + s * cs + t * ct;
        const float plane = c * m[6 * BLOCK + x] + cs * m[7 * BLOCK + x] + ct * m[8 * BLOCK + x];
        out[i + x] = disparity[i + x]
                     + (det > 1e-6f * w * c ? plane / det : m[6 * BLOCK + x] / w);
        known[i + x] = m[9 * BLOCK + x];
    }
}
#endif
