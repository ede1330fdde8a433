/* gather of support.cl in vectors of sixteen pixels, for CPUs.
 *
 *   out[p, y, x] = sum_st w cost[p, y + s, x + t] / sum_st w,   |s|, |t| <= RADIUS
 *
 * An item is 16 pixels of a row and the planes that they want (spans.cl). The weights of a pixel are
 * found once; each is read once for GATHER_PLANES planes, whose sums stay in registers. Costs beside a
 * row are read with weight 0, and are finite.
 *
 * -DCHANNELS=n, -DRADIUS=n
 */
#include "common.cl"
#include "lanes.cl"
#include "bell.cl"
#include "spans.cl"

#define SIDE (2 * RADIUS + 1)
#define GATHER_PLANES 8

/* 16 costs, 0 outside of begin <= x < end. */
inline float16 inside16(__global const float *cost, const int begin, const int end)
{
    union { float16 v; float s[16]; } here;
    here.v = (float16)(0.0f);
    for (int x = begin; x < end; ++x)
        here.s[x] = cost[x];
    return here.v;
}

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void gather_rows(__global float *restrict out, __global const float *restrict cost,
                          __global const int2 *restrict spans, __global const float *restrict I,
                          __global const float *restrict near, __global const float *restrict alike,
                          const int planes, const int ny, const int nx)
{
    const int x0 = get_global_id(0) * 16, y = get_global_id(1);
    if (x0 >= nx)
        return;
    const int n = min(16, nx - x0);
    const long start = (long)row_start(0, y, ny, nx) + x0, step = (long)ny * nx;
    const int2 span = span_of(spans, y, x0, nx);
    if (span.x > span.y)
        return;
    union { float16 v; float s[16]; } w[SIDE * SIDE], total;
    const int above = max(-RADIUS, -y), below = min(RADIUS, ny - 1 - y);

    total.v = (float16)(0.0f);
    for (int s = above; s <= below; ++s)
        for (int t = -RADIUS; t <= RADIUS; ++t) {
            const int k = (s + RADIUS) * SIDE + t + RADIUS;
            const int begin = clamp(-t - x0, 0, n), end = clamp(nx - t - x0, begin, n);
            w[k].v = (float16)(0.0f);
            for (int x = begin; x < end; ++x) {
                const long i = start + x, j = i + s * nx + t;
                float q = 0;
                for (int c = 0; c < CHANNELS; ++c) {
                    const float d = I[c * step + j] - I[c * step + i];
                    q += d * d;
                }
                w[k].s[x] = bell(near[i] * (s * s + t * t) + q * alike[i]);
            }
            total.v += w[k].v;
        }
    const float16 share = (float16)(1.0f) / total.v;
    for (int p = span.x; p <= span.y; p += GATHER_PLANES) {
        float16 sum[GATHER_PLANES];
        const int last = min(GATHER_PLANES, span.y + 1 - p) - 1;
#pragma unroll
        for (int q = 0; q < GATHER_PLANES; ++q)
            sum[q] = (float16)(0.0f);
        for (int s = above; s <= below; ++s)
            for (int t = -RADIUS; t <= RADIUS; ++t) {
                const int k = (s + RADIUS) * SIDE + t + RADIUS;
                const long from = p * step + start + s * nx + t;
                if (from >= 0 && from + last * step + 16 <= planes * step) {
#pragma unroll
                    for (int q = 0; q < GATHER_PLANES; ++q)
                        sum[q] += w[k].v * load16(cost + from + min(q, last) * step);
                } else {
                    const int begin = clamp(-t - x0, 0, n), end = clamp(nx - t - x0, begin, n);
#pragma unroll
                    for (int q = 0; q < GATHER_PLANES; ++q)
                        sum[q] += w[k].v * inside16(cost + from + min(q, last) * step, begin, end);
                }
            }
#pragma unroll
        for (int q = 0; q < GATHER_PLANES; ++q) {
            if (q > last)
                continue;
            const float16 mean = sum[q] * share;
            __global float *to = out + (p + q) * step + start;
            if (n == 16) {
                store16(to, mean);
            } else {
                union { float16 v; float s[16]; } rest;
                rest.v = mean;
                for (int x = 0; x < n; ++x)
                    to[x] = rest.s[x];
            }
        }
    }
}
