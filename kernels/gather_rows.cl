/* gather of support.cl in vectors, for CPUs.
 *
 *   out[p, y, x] = sum_st w cost[p, y + s, x + t] / sum_st w,   |s|, |t| <= RADIUS
 *
 * An item is 16 pixels of a row and the planes that they want (spans.cl); axis 0 = y, so that
 * neighbouring rows are read from the nearest caches. The weights of LANES pixels are found once; each
 * is read once for GATHER_PLANES planes, whose sums stay in registers. Costs beside a row are read with
 * weight 0, and are finite.
 *
 * -DLANES=4 | 8 | 16, -DCHANNELS=n, -DRADIUS=n
 */
#include "common.cl"
#include "vectors.cl"
#include "bell.cl"
#include "spans.cl"

#define SIDE (2 * RADIUS + 1)
#define GATHER_PLANES 8

/* The weights of the neighbours of LANES pixels of row y from x0 on, and their sum. */
inline vec weigh(vec *w, __global const float *I, __global const float *near,
                 __global const float *alike, const int x0, const int y, const int ny, const int nx)
{
    const long step = (long)ny * nx, i = (long)y * nx + x0;
    const vec close = load_within(near, i, step), same = load_within(alike, i, step);
    vec here[CHANNELS], total = (vec)(0.0f);
    for (int c = 0; c < CHANNELS; ++c)
        here[c] = load_within(I + c * step, i, step);
    const int inner = x0 >= RADIUS && x0 + LANES + RADIUS <= nx;
    for (int s = -LESS(RADIUS, y); s <= LESS(RADIUS, ny - 1 - y); ++s)
        for (int t = -RADIUS; t <= RADIUS; ++t) {
            const long j = i + (long)s * nx + t;
            vec q = (vec)(0.0f);
            for (int c = 0; c < CHANNELS; ++c) {
                const vec there = inner ? load(I + c * step + j) : load_within(I + c * step, j, step);
                q += (there - here[c]) * (there - here[c]);
            }
            vec weight = bells(close * (vec)((float)(s * s + t * t)) + q * same);
            if (!inner) {
                const ivec x = LANE + (ivec)(x0 + t);
                weight = x >= (ivec)(0) & x < (ivec)(nx) ? weight : (vec)(0.0f);
            }
            w[(s + RADIUS) * SIDE + t + RADIUS] = weight;
            total += weight;
        }
    return total;
}

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void gather_rows(__global float *restrict out, __global const float *restrict cost,
                          __global const int2 *restrict spans, __global const float *restrict I,
                          __global const float *restrict near, __global const float *restrict alike,
                          const int planes, const int ny, const int nx)
{
    const int y = get_global_id(0), first = get_global_id(1) * 16;
    const long step = (long)ny * nx;
    const int2 span = span_of(spans, y, first, nx);
    if (span.x > span.y)
        return;
    vec w[SIDE * SIDE];
    const int above = -LESS(RADIUS, y), below = LESS(RADIUS, ny - 1 - y);
    for (int x0 = first; x0 < LESS(first + 16, nx); x0 += LANES) {
        const long start = (long)y * nx + x0;
        const vec share = (vec)(1.0f) / weigh(w, I, near, alike, x0, y, ny, nx);
        for (int p = span.x; p <= span.y; p += GATHER_PLANES) {
            vec sum[GATHER_PLANES];
            long plane[GATHER_PLANES]; /* the last one again and again at the end of a span */
#pragma unroll
            for (int q = 0; q < GATHER_PLANES; ++q) {
                sum[q] = (vec)(0.0f);
                plane[q] = LESS(p + q, span.y) * step + start;
            }
            const int inner = plane[0] + above * nx - RADIUS >= 0
                              && plane[GATHER_PLANES - 1] + below * nx + RADIUS + LANES <= planes * step;
            for (int s = above; s <= below; ++s) {
                const vec *weight = w + (s + RADIUS) * SIDE + RADIUS;
                if (inner) {
                    __global const float *from[GATHER_PLANES];
#pragma unroll
                    for (int q = 0; q < GATHER_PLANES; ++q)
                        from[q] = cost + plane[q] + s * nx;
                    for (int t = -RADIUS; t <= RADIUS; ++t)
#pragma unroll
                        for (int q = 0; q < GATHER_PLANES; ++q)
                            sum[q] += weight[t] * load(from[q] + t);
                } else {
                    for (int t = -RADIUS; t <= RADIUS; ++t)
#pragma unroll
                        for (int q = 0; q < GATHER_PLANES; ++q)
                            sum[q] += weight[t]
                                      * load_within(cost, plane[q] + s * nx + t, planes * step);
                }
            }
#pragma unroll
            for (int q = 0; q < GATHER_PLANES; ++q) {
                __global float *to = out + plane[q];
                if (p + q > span.y)
                    continue;
                if (x0 + LANES <= nx)
                    store(to, sum[q] * share);
                else
                    store_some(to, sum[q] * share, nx - x0);
            }
        }
    }
}
