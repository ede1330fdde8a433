/* Costs averaged over similar neighbours (Yoon and Kweon 2006, adaptive support).
 *
 *   out[p, y, x] = sum_st w cost[p, y + s, x + t] / sum_st w,   |s|, |t| <= RADIUS
 *   w = bell((s^2 + t^2) near[y, x] + sum_c (I[c, y + s, x + t] - I[c, y, x])^2 alike[y, x])
 *   bell(q) = max(1 - q/8, 0)^8, close to exp(-q), and 0 beyond 8
 *
 *   valley   the plane of least cost, refined by the parabola through it and its neighbours,
 *            which may be at unequal distances; its number, its cost, the second lowest valley and
 *            the mean
 *
 * gather: an item is BLOCK pixels of a row, all planes of their spans (spans.cl). valley:
 * FOR_X over x, among the planes spans[y, x] = (first, last); skipped where last < first.
 * -DCHANNELS=n, -DRADIUS=n, -DBLOCK=n; -DROWS: see common.cl
 */
#include "common.cl"
#include "bell.cl"
#include "spans.cl"

#ifdef RADIUS
#define SIDE (2 * RADIUS + 1)

#if BLOCK > 1
__attribute__((reqd_work_group_size(1, 1, 1)))
#endif
__kernel void gather(__global float *restrict out, __global const float *restrict cost,
                     __global const int2 *restrict spans, __global const float *restrict I,
                     __global const float *restrict near, __global const float *restrict alike, const int planes, const int ny,
                     const int nx)
{
    const int x0 = get_global_id(0) * BLOCK, y = get_global_id(1);
    if (x0 >= nx)
        return;
    const int n = min(BLOCK, nx - x0);
    int lowest = planes, highest = -1;
    for (int x = x0 & ~15; x < x0 + n; x += 16) {
        const int2 span = span_of(spans, y, x, nx);
        if (span.x <= span.y) {
            lowest = min(lowest, span.x);
            highest = max(highest, span.y);
        }
    }
    if (lowest > highest)
        return;
    float w[SIDE * SIDE * BLOCK], sum[BLOCK], total[BLOCK];
    __global const float *here = I + row_start(0, y, ny, nx) + x0;
    const size_t size = (size_t)ny * nx;
    const int above = max(-RADIUS, -y), below = min(RADIUS, ny - 1 - y);

    for (int x = 0; x < n; ++x)
        total[x] = 0;
    for (int s = above; s <= below; ++s)
        for (int t = -RADIUS; t <= RADIUS; ++t) {
            float *to = w + ((s + RADIUS) * SIDE + t + RADIUS) * BLOCK;
            const int begin = clamp(-t - x0, 0, n), end = clamp(nx - t - x0, begin, n);
            __global const float *there = here + s * nx + t;
            __global const float *close = near + row_start(0, y, ny, nx) + x0;
            __global const float *same = alike + row_start(0, y, ny, nx) + x0;
            for (int x = begin; x < end; ++x) {
                float q = 0;
                for (int c = 0; c < CHANNELS; ++c) {
                    const float d = there[c * size + x] - here[c * size + x];
                    q += d * d;
                }
                to[x] = bell(close[x] * (s * s + t * t) + q * same[x]);
                total[x] += to[x];
            }
        }
    for (int p = lowest; p <= highest; ++p) {
        const size_t row = row_start(p, y, ny, nx) + x0;
        for (int x = 0; x < n; ++x)
            sum[x] = 0;
        for (int s = above; s <= below; ++s)
            for (int t = -RADIUS; t <= RADIUS; ++t) {
                const float *from = w + ((s + RADIUS) * SIDE + t + RADIUS) * BLOCK;
                const int begin = clamp(-t - x0, 0, n), end = clamp(nx - t - x0, begin, n);
                __global const float *there = cost + row + s * nx + t;
                for (int x = begin; x < end; ++x)
                    sum[x] += from[x] * there[x];
            }
        for (int x = 0; x < n; ++x)
            out[row + x] = sum[x] / total[x];
    }
}
#endif

__kernel void valley(__global float *restrict place, __global int *restrict nearest,
                     __global float *restrict least, __global float *restrict second,
                     __global float *restrict mean, __global const float *restrict cost,
                     __global const int2 *restrict spans, __global const float *restrict d,
                     const int planes, const int ny, const int nx)
{
    const int y = get_global_id(1);
    const size_t step = (size_t)ny * nx;
    FOR_X(x, nx) {
        const size_t i = row_start(0, y, ny, nx) + x;
        const int2 span = spans[i];
        if (span.x > span.y)
            continue;
        float lowest = INFINITY, next = INFINITY, sum = 0;
        int best = span.x;
        for (int p = span.x; p <= span.y; ++p) {
            const float e = cost[p * step + i];
            const float before = p > span.x ? cost[(p - 1) * step + i] : INFINITY;
            const float after = p < span.y ? cost[(p + 1) * step + i] : INFINITY;
            sum += e;
            if (!(e <= before && e < after))
                continue;
            if (e < lowest) {
                next = lowest;
                lowest = e;
                best = p;
            } else {
                next = fmin(next, e);
            }
        }
        float found = d[best], bottom = isfinite(lowest) ? lowest : cost[best * step + i];
        if (best > span.x && best < span.y) {
            const float before = cost[(best - 1) * step + i], after = cost[(best + 1) * step + i];
            const float h0 = d[best] - d[best - 1], h1 = d[best + 1] - d[best];
            const float s0 = (before - lowest) / h0, s1 = (after - lowest) / h1;
            const float bend = s0 + s1;
            const float off = bend > 0 ? 0.5f * (s0 * h1 - s1 * h0) / bend : 0.0f;
            found += clamp(off, -0.5f * h0, 0.5f * h1);
            bottom = fmax(lowest - 0.5f * fabs(before - after), 0.0f);
        }
        place[i] = found;
        nearest[i] = best;
        least[i] = bottom;
        second[i] = next;
        mean[i] = sum / (span.y - span.x + 1);
    }
}
