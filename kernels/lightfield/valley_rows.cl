/* valley of support.cl in vectors, for CPUs.
 *
 *   the plane of least cost, refined by a parabola; its number, the cost, the second lowest valley,
 *   the mean
 *
 * An item is LANES pixels of a row, and all planes of their spans.
 *
 * -DLANES=4 | 8 | 16
 */
#include "common.cl"
#include "vectors.cl"

/* The span of each of LANES pixels, empty for pixels beyond the row. */
inline void pixel_spans(ivec *first, ivec *last, __global const int2 *spans, const int n)
{
    union { ivec v; int s[LANES]; } low, high;
    for (int x = 0; x < LANES; ++x) {
        const int2 span = x < n ? spans[x] : (int2)(1, 0);
        low.s[x] = span.x;
        high.s[x] = span.y;
    }
    *first = low.v;
    *last = high.v;
}

/* Costs of LANES pixels on a plane, infinite outside their spans. */
inline vec wanted_cost(__global const float *cost, const int p, const ivec first, const ivec last,
                       const long step, const int n)
{
    const vec e = n >= LANES ? load(cost + p * step) : load_some(cost + p * step, n);
    return (((ivec)(p) >= first) & ((ivec)(p) <= last)) ? e : (vec)(INFINITY);
}

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void valley_rows(__global float *restrict place, __global int *restrict nearest,
                          __global float *restrict least, __global float *restrict second,
                          __global float *restrict mean, __global const float *restrict cost,
                          __global const int2 *restrict spans, __global const float *restrict d,
                          const int planes, const int ny, const int nx)
{
    const int x0 = get_global_id(0) * LANES, y = get_global_id(1), n = LESS(nx - x0, LANES);
    if (x0 >= nx)
        return;
    const long i = (long)y * nx + x0, step = (long)ny * nx;
    const vec beyond = (vec)(INFINITY);
    union { vec v; float s[LANES]; } lowest, next, sum, before, after, begin;
    union { ivec v; int s[LANES]; } first, last, best;
    pixel_spans(&first.v, &last.v, spans + i, n);
    int low = planes, high = -1;
    for (int x = 0; x < LANES; ++x)
        if (first.s[x] <= last.s[x]) {
            low = LESS(low, first.s[x]);
            high = max(high, last.s[x]);
        }
    if (low > high)
        return;
    cost += i;
    lowest.v = next.v = before.v = after.v = begin.v = beyond;
    sum.v = (vec)(0.0f);
    best.v = first.v;
    vec previous = beyond, e = wanted_cost(cost, low, first.v, last.v, step, n);
    for (int p = low; p <= high; ++p) {
        const vec following
            = p < high ? wanted_cost(cost, p + 1, first.v, last.v, step, n) : beyond;
        const ivec is_valley = (e <= previous) & (e < following);
        const ivec lower = is_valley & (e < lowest.v), higher = is_valley & (e >= lowest.v);
        sum.v += e < beyond ? e : (vec)(0.0f);
        begin.v = (ivec)(p) == first.v ? e : begin.v;
        next.v = lower ? lowest.v : (higher & (e < next.v)) ? e : next.v;
        before.v = lower ? previous : before.v;
        after.v = lower ? following : after.v;
        best.v = lower ? (ivec)(p) : best.v;
        lowest.v = lower ? e : lowest.v;
        previous = e;
        e = following;
    }
    for (int x = 0; x < n; ++x) {
        const int b = best.s[x];
        if (first.s[x] > last.s[x])
            continue;
        float found = d[b], bottom = isfinite(lowest.s[x]) ? lowest.s[x] : begin.s[x];
        if (b > first.s[x] && b < last.s[x]) {
            const float h0 = d[b] - d[b - 1], h1 = d[b + 1] - d[b];
            const float s0 = (before.s[x] - bottom) / h0, s1 = (after.s[x] - bottom) / h1;
            const float bend = s0 + s1;
            const float off = bend > 0 ? 0.5f * (s0 * h1 - s1 * h0) / bend : 0.0f;
            found += BOUND(off, -0.5f * h0, 0.5f * h1);
            bottom = fmax(bottom - 0.5f * fabs(before.s[x] - after.s[x]), 0.0f);
        }
        place[i + x] = found;
        nearest[i + x] = b;
        least[i + x] = bottom;
        second[i + x] = next.s[x];
        mean[i + x] = sum.s[x] / (last.s[x] - first.s[x] + 1);
    }
}
