/* gather of support.cl in vectors, for CPUs.
 *
 *   out[p, y, x] = sum_st w cost[p, y + s, x + t] / sum_st w,   |s|, |t| <= RADIUS
 *
 * An item is 16 pixels of a row and their planes (spans.cl); axis 0 = y, so that
 * neighbouring rows are read from the nearest caches. Weights are computed once; each is read once for
 * GATHER_PLANES planes, whose sums stay in registers. Their costs are copied first, because
 * planes a power of two apart evict each other from the caches. Costs outside a row are finite
 * and read with weight 0.
 *
 * -DLANES=4 | 8 | 16, -DCHANNELS=n, -DRADIUS=n
 */
#include "common.cl"
#include "vectors.cl"
#include "bell.cl"
#include "spans.cl"

#define SIDE (2 * RADIUS + 1)
#define GATHER_PLANES 8
#define ITEM_VECTORS (16 / LANES)
#define COPIED ((16 + 2 * RADIUS + LANES - 1) / LANES * LANES) /* costs of a row and plane */
#define EACH_PLANE(q) _Pragma("unroll") for (int q = 0; q < GATHER_PLANES; ++q)

/* Rows above to below of the costs round an item, from pixel `at` of row 0 and plane p on; planes
 * after the last one repeat it. */
inline void copy_costs(float *to, __global const float *cost, const long at, const int p,
                       const int last, const int above, const int below, const int nx,
                       const long step, const long size)
{
    EACH_PLANE(q) {
        const long first = LESS(p + q, last) * step + at;
        const int inner = first + (long)above * nx >= 0 && first + (long)below * nx + COPIED <= size;
        float *row = to + ((above + RADIUS) * GATHER_PLANES + q) * COPIED;
        for (int s = above; s <= below; ++s, row += GATHER_PLANES * COPIED) {
            __global const float *from = cost + first + (long)s * nx;
            if (inner) {
#pragma unroll
                for (int i = 0; i < COPIED; i += LANES)
                    store_own(row + i, load(from + i));
            } else {
                for (int i = 0; i < COPIED; i += LANES)
                    store_own(row + i, load_within(cost, first + (long)s * nx + i, size));
            }
        }
    }
}

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
                weight = ((x >= (ivec)(0)) & (x < (ivec)(nx))) ? weight : (vec)(0.0f);
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
    vec w[ITEM_VECTORS * SIDE * SIDE], share[ITEM_VECTORS];
    float copied[SIDE * GATHER_PLANES * COPIED];
    const int above = -LESS(RADIUS, y), below = LESS(RADIUS, ny - 1 - y);
    const int vectors = (LESS(16, nx - first) + LANES - 1) / LANES;
    const long start = (long)y * nx + first;
    for (int v = 0; v < vectors; ++v)
        share[v] = (vec)(1.0f) / weigh(w + v * SIDE * SIDE, I, near, alike, first + v * LANES, y, ny, nx);
    for (int p = span.x; p <= span.y; p += GATHER_PLANES) {
        copy_costs(copied, cost, start - RADIUS, p, span.y, above, below, nx, step, planes * step);
        for (int v = 0; v < vectors; ++v) {
            vec sum[GATHER_PLANES];
            EACH_PLANE(q)
                sum[q] = (vec)(0.0f);
            for (int s = above + RADIUS; s <= below + RADIUS; ++s) {
                const vec *weight = w + (v * SIDE + s) * SIDE;
                const float *from = copied + s * GATHER_PLANES * COPIED + v * LANES;
                for (int t = 0; t < SIDE; ++t)
                    EACH_PLANE(q)
                        sum[q] += weight[t] * load_own(from + q * COPIED + t);
            }
            EACH_PLANE(q) {
                __global float *to = out + (p + q) * step + start + v * LANES;
                if (p + q > span.y)
                    continue;
                if (first + (v + 1) * LANES <= nx)
                    store(to, sum[q] * share[v]);
                else
                    store_some(to, sum[q] * share[v], nx - first - v * LANES);
            }
        }
    }
}
