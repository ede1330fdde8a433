/* match of matching.cl in vectors of sixteen samples, for CPUs and light fields of one or three channels.
 *
 *   cost[p, y, x] = min(m_0, ratio min_j m_j + margin)
 *
 * A sample that interpolation needs is combined along y once for four pixels along x. An item is
 * MATCH_VECTORS vectors of 16 pixels of a row on one plane; axis 0 = planes, axis 1 = y, axis 2 =
 * those, so that the rows of all views that planes share are read from the nearest caches.
 * Vectors at the ends of an item are left as they are where the plane is not wanted (spans.cl).
 *
 * -DSAMPLE=uchar | ushort | half | float, -DLANES=16, -DCHANNELS=1 | 3, -DMATCH_VECTORS=n
 */
#include "common.cl"
#include "spans.cl"
#include "strips.cl"

#define GROUPS 9
#define MATCH_CHUNK (16 * MATCH_VECTORS)

/* Differences to the centre at 16 pixels, added over the channels. */
inline float16 difference(const float16 *value, const float16 *centre)
{
#if CHANNELS == 1
    return magnitude(value[0] - centre[0]);
#else
    const float16 a = magnitude(value[0] - centre[0]), b = magnitude(value[1] - centre[1]);
    const float16 c = magnitude(value[2] - centre[2]);
    return CHANNEL_0(a, b, c) + CHANNEL_1(a, b, c) + CHANNEL_2(a, b, c);
#endif
}

/* A view moved by `at` to pixels from x0 on, `vectors` times sixteen, clamped at its edges. */
typedef struct {
    strip rows;
    int first;
    float4 across;
    float16 last; /* what the next vector starts with */
} moved;

inline moved moved_view(__global const SAMPLE *view, const int y, const int x0, const int2 at,
                        const float4 down, const float4 across, const int ny, const int nx)
{
    moved m;
    m.rows = strip_of(view, y + at.x - 1, down, ny, nx);
    m.first = (x0 + at.y - 1) * CHANNELS;
    m.across = across;
    m.last = strip_load(m.rows, m.first);
    return m;
}

/* The next 16 pixels. */
inline void next_pixels(float16 *value, moved *m)
{
#pragma unroll
    for (int j = 0; j < CHANNELS; ++j) {
        m->first += 16;
        const float16 b = strip_load(m->rows, m->first);
        value[j] = across_taps(m->across, m->last, b);
        m->last = b;
    }
}

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void match_rows(__global float *restrict out, __global const SAMPLE *restrict L,
                         __global const int2 *restrict spans, __global const int *restrict view,
                         __global const int2 *restrict at,
                         __global const float4 *restrict part, __global const int2 *restrict reach,
                         __global const int *restrict first, __global const float *restrict pattern,
                         const int patterns, __global const int *restrict reference,
                         __global const float *restrict share, const int references,
                         const int views, const int ny, const int nx, const float tau,
                         const float ratio, const float margin)
{
    const int p = get_global_id(0), y = get_global_id(1);
    int x0 = get_global_id(2) * MATCH_CHUNK, end_x = min(x0 + MATCH_CHUNK, nx);
    while (x0 < end_x && !in_span(spans, y, x0, p, nx))
        x0 += 16;
    while (x0 < end_x && !in_span(spans, y, end_x - 1, p, nx))
        end_x = (end_x - 1) & ~15;
    if (x0 >= end_x)
        return;
    const int n = end_x - x0, vectors = (n + 15) / 16;
    const size_t size = (size_t)ny * nx * CHANNELS;
    const float16 most_cost = (float16)(tau);
    float16 centre[MATCH_VECTORS * CHANNELS], value[CHANNELS];
    float16 sums[GROUPS * MATCH_VECTORS], seen[GROUPS * MATCH_VECTORS];
    float16 part_sum[MATCH_VECTORS], part_seen[MATCH_VECTORS];
    float most[GROUPS], seen_whole[GROUPS];

    for (int j = 0; j < vectors * CHANNELS; ++j)
        centre[j] = (float16)(0.0f);
    for (int r = 0; r < references; ++r) {
        const int k = p * views + reference[r];
        moved m = moved_view(L + view[reference[r]] * size, y, x0, at[k], part[2 * k],
                             part[2 * k + 1], ny, nx);
        for (int i = 0; i < vectors; ++i) {
            next_pixels(value, &m);
            for (int c = 0; c < CHANNELS; ++c)
                centre[i * CHANNELS + c] += (float16)(share[r]) * value[c];
        }
    }
    for (int i = 0; i < GROUPS * MATCH_VECTORS; ++i)
        sums[i] = seen[i] = (float16)(0.0f);
    for (int j = 0; j < GROUPS; ++j)
        most[j] = seen_whole[j] = 0;

    for (int g = 0; g < patterns; ++g) {
        float whole = 0; /* views that see all pixels of the chunk */
        int some = 0;    /* whether a view sees some of them */
        for (int i = 0; i < vectors; ++i)
            part_sum[i] = part_seen[i] = (float16)(0.0f);
        for (int v = first[g]; v < first[g + 1]; ++v) {
            const int k = p * views + v;
            const int row = y + at[k].x;
            const int begin = clamp(-at[k].y - x0, 0, n);
            const int end = clamp(nx - at[k].y - reach[k].y - x0, begin, n);
            if (row < 0 || row + reach[k].x >= ny || begin == end)
                continue;
            moved m = moved_view(L + view[v] * size, y, x0, at[k], part[2 * k], part[2 * k + 1],
                                 ny, nx);
            if (begin == 0 && end == n) {
                whole += 1;
                for (int i = 0; i < vectors; ++i) {
                    next_pixels(value, &m);
                    const float16 e = difference(value, centre + i * CHANNELS);
                    part_sum[i] += e < most_cost ? e : most_cost;
                }
                continue;
            }
            some = 1;
            for (int i = 0; i < vectors; ++i) {
                next_pixels(value, &m);
                const float16 e = difference(value, centre + i * CHANNELS);
                const int16 x = LANE + (int16)(16 * i);
                const int16 sees = x >= (int16)(begin) & x < (int16)(end);
                part_sum[i] += sees ? (e < most_cost ? e : most_cost) : (float16)(0.0f);
                part_seen[i] += sees ? (float16)(1.0f) : (float16)(0.0f);
            }
        }
        for (int j = 0; j < GROUPS; ++j) {
            const float w = pattern[g * GROUPS + j];
            most[j] += w * (first[g + 1] - first[g]);
            if (w == 0)
                continue;
            seen_whole[j] += w * whole;
            for (int i = 0; i < vectors; ++i)
                sums[j * MATCH_VECTORS + i] += (float16)(w) * part_sum[i];
            if (some)
                for (int i = 0; i < vectors; ++i)
                    seen[j * MATCH_VECTORS + i] += (float16)(w) * part_seen[i];
        }
    }

    out += row_start(p, y, ny, nx) + x0;
    for (int i = 0; i < vectors; ++i) {
        const float16 none = (float16)(0.0f);
        const float16 every = seen[i] + (float16)(seen_whole[0]);
        float16 least = every > none ? sums[i] / every : most_cost;
        for (int j = 1; j < GROUPS; ++j) {
            const float16 count = seen[j * MATCH_VECTORS + i] + (float16)(seen_whole[j]);
            const float16 mean = (float16)(ratio) * sums[j * MATCH_VECTORS + i] / count + (float16)(margin);
            const int16 counts = count > none & count >= (float16)(0.5f * most[j]) & mean < least;
            least = counts ? mean : least;
        }
        if (16 * i + 16 <= n) {
            store16(out + 16 * i, least);
        } else {
            union { float16 v; float s[16]; } last;
            last.v = least;
            for (int x = 0; 16 * i + x < n; ++x)
                out[16 * i + x] = last.s[x];
        }
    }
}
