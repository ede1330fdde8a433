/* match of matching.cl in vectors, for CPUs and light fields of one or three channels.
 *
 *   cost[p, y, x] = min(m_0, ratio min_j m_j + margin)
 *
 * An item is MATCH_HEIGHT rows of 16 MATCH_VECTORS pixels on one plane; axis 0 = planes, axis 1 =
 * rows, axis 2 = pixels, so that the rows of all views that planes share are read from the nearest
 * caches. Its part of a view is combined along y once, and then interpolated along x
 * and compared row by row. 16 pixels at the ends of an item are skipped if the plane is outside the
 * spans of all rows (spans.cl).
 *
 * -DSAMPLE=uchar | ushort | half | float, -DLANES=4 | 8 | 16, -DCHANNELS=1 | 3, -DMATCH_VECTORS=n
 */
#include "common.cl"
#include "spans.cl"
#include "vectors.cl"

#define GROUPS 9
#define MATCH_HEIGHT 4
#define MATCH_CHUNK (16 * MATCH_VECTORS)
#define ROW_VECTORS (MATCH_CHUNK / LANES)
#define ALL_VECTORS (MATCH_HEIGHT * ROW_VECTORS)
#define PATTERNS 18 /* added to the sums of the groups at a time */
#define STRIP_HEIGHT MATCH_HEIGHT
#define STRIP_PITCH ((MATCH_CHUNK + 4) * CHANNELS)

/* Neighbouring rows of views combined along y by four taps each, and interpolated along x:
 *
 *   to[r, i] = sum_t taps[t] view[top + r + t, first + i],   0 <= r < STRIP_HEIGHT, 0 <= i < count
 *
 * i counts samples, channels fastest; beyond the edges the outermost pixel is repeated. Every row is
 * read and converted once for all r; STRIP_PITCH floats lie between rows of `to`. */
inline float strip_sample(__global const SAMPLE *const *row, const float4 taps, const int i)
{
    return taps.x * stored(row[0], i) + taps.y * stored(row[1], i) + taps.z * stored(row[2], i)
           + taps.w * stored(row[3], i);
}

/* The samples of a strip that lie inside the view, from begin to end. */
inline void strip_inside(float *to, __global const SAMPLE *const *row, const int first,
                         const int begin, const int end, const float4 taps)
{
    if (end - begin < LANES) {
        for (int r = 0; r < STRIP_HEIGHT; ++r)
            for (int i = begin; i < end; ++i)
                to[r * STRIP_PITCH + i] = strip_sample(row + r, taps, first + i);
        return;
    }
    const vec a = (vec)(taps.x), b = (vec)(taps.y), c = (vec)(taps.z), d = (vec)(taps.w);
    for (int j = begin; j < end; j += LANES) { /* the last vector overlaps the previous one */
        const int i = LESS(j, end - LANES);
        vec v[STRIP_HEIGHT + 3];
#pragma unroll
        for (int t = 0; t < STRIP_HEIGHT + 3; ++t)
            v[t] = stored_vec(row[t] + first + i);
#pragma unroll
        for (int r = 0; r < STRIP_HEIGHT; ++r)
            store_own(to + r * STRIP_PITCH + i,
                      a * v[r] + b * v[r + 1] + c * v[r + 2] + d * v[r + 3]);
    }
}

inline void strip(float *to, __global const SAMPLE *view, const int top, const int first,
                  const int count, const float4 taps, const int ny, const int nx)
{
    const int samples = nx * CHANNELS;
    const int begin = BOUND(-first, 0, count), end = BOUND(samples - first, begin, count);
    __global const SAMPLE *row[STRIP_HEIGHT + 3];
#pragma unroll
    for (int t = 0; t < STRIP_HEIGHT + 3; ++t)
        row[t] = view + (size_t)BOUND(top + t, 0, ny - 1) * samples;
    strip_inside(to, row, first, begin, end, taps);
    if (begin == 0 && end == count)
        return;
    for (int r = 0; r < STRIP_HEIGHT; ++r)
        for (int c = 0; c < CHANNELS; ++c) {
            const float left = strip_sample(row + r, taps, c);
            const float right = strip_sample(row + r, taps, samples - CHANNELS + c);
            for (int i = c; i < begin; i += CHANNELS)
                to[r * STRIP_PITCH + i] = left;
            for (int i = end + c; i < count; i += CHANNELS)
                to[r * STRIP_PITCH + i] = right;
        }
}

/* Interpolated along x: LANES samples of a strip, of which the first lies between the second pixel
 * from `from` on and the next. */
inline vec across_taps(const float4 taps, const float *from)
{
    return (vec)(taps.x) * load_own(from) + (vec)(taps.y) * load_own(from + CHANNELS)
           + (vec)(taps.z) * load_own(from + 2 * CHANNELS)
           + (vec)(taps.w) * load_own(from + 3 * CHANNELS);
}

/* Differences to the centre at LANES pixels, summed over the channels, at most tau. */
inline vec difference(const float *strip, const float4 across, const vec *centre, const float tau)
{
    vec e = magnitude(across_taps(across, strip) - centre[0]);
#if CHANNELS == 3
    const vec a = e, b = magnitude(across_taps(across, strip + LANES) - centre[1]);
    const vec c = magnitude(across_taps(across, strip + 2 * LANES) - centre[2]);
    e = CHANNEL_0(a, b, c) + CHANNEL_1(a, b, c) + CHANNEL_2(a, b, c);
#endif
    return e < (vec)(tau) ? e : (vec)(tau);
}

/* True if the spans of some rows include the plane for 16 pixels from x on. */
inline int wants(__global const int2 *spans, const int y, const int rows, const int x, const int p,
                 const int nx)
{
    int any = 0;
    for (int r = 0; r < rows; ++r)
        any |= in_span(spans, y + r, x, p, nx);
    return any;
}

/* The least mean of a group, or of all views, at LANES pixels. */
inline vec least_mean(const vec *sums, const vec *unseen, const int some, const float *seen,
                      const float *most, const float tau,
                      const float ratio, const float margin)
{
    const vec none = (vec)(0.0f);
    const vec every = (vec)(seen[0]) - (some ? unseen[0] : none);
    vec least = every > none ? sums[0] / every : (vec)(tau);
    for (int j = 1; j < GROUPS; ++j) {
        const vec count = (vec)(seen[j]) - (some ? unseen[j * ALL_VECTORS] : none);
        const vec mean = (vec)(ratio) * sums[j * ALL_VECTORS] / count + (vec)(margin);
        const ivec counts = (count > none) & (count >= (vec)(0.5f * most[j])) & (mean < least);
        least = counts ? mean : least;
    }
    return least;
}

/* sums[j] += sum of pattern[g, j] part[g] over some patterns g. */
inline void add_patterns(vec *sums, const vec *part, __global const float *pattern,
                         const int patterns)
{
    for (int j = 0; j < GROUPS; ++j) {
        int count = 0;
        const vec *from[PATTERNS];
        float w[PATTERNS];
        for (int g = 0; g < patterns; ++g)
            if (pattern[g * GROUPS + j] != 0) {
                from[count] = part + g * ALL_VECTORS;
                w[count++] = pattern[g * GROUPS + j];
            }
        for (long i = 0; i < ALL_VECTORS; i += 4) {
            vec *to = sums + j * ALL_VECTORS + i;
            vec a = to[0], b = to[1], c = to[2], d = to[3];
            for (int g = 0; g < count; ++g) {
                const vec *more = from[g] + i;
                a += (vec)(w[g]) * more[0];
                b += (vec)(w[g]) * more[1];
                c += (vec)(w[g]) * more[2];
                d += (vec)(w[g]) * more[3];
            }
            to[0] = a, to[1] = b, to[2] = c, to[3] = d;
        }
    }
}

/* Costs of the pixels of a view from begin to end, and the number of views that do not see the others, of a row. */
inline void add_part(vec *sum, vec *unseen, const float *from, const float4 across,
                     const vec *centre, const int begin, const int end, const int vectors,
                     const float tau)
{
    const vec none = (vec)(0.0f), one = (vec)(1.0f);
    for (int i = 0; i < vectors; ++i) {
        const vec e = difference(from + i * LANES * CHANNELS, across, centre + i * CHANNELS, tau);
        if (begin <= i * LANES && end >= (i + 1) * LANES) {
            sum[i] += e;
            continue;
        }
        const ivec x = LANE + (ivec)(LANES * i);
        const ivec sees = (x >= (ivec)(begin)) & (x < (ivec)(end));
        sum[i] += sees ? e : none;
        unseen[i] += sees ? none : one;
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
    const int p = get_global_id(0), y = get_global_id(1) * MATCH_HEIGHT;
    const int rows = LESS(MATCH_HEIGHT, ny - y);
    int x0 = get_global_id(2) * MATCH_CHUNK, end_x = LESS(x0 + MATCH_CHUNK, nx);
    while (x0 < end_x && !wants(spans, y, rows, x0, p, nx))
        x0 += 16;
    while (x0 < end_x && !wants(spans, y, rows, end_x - 1, p, nx))
        end_x = (end_x - 1) & ~15;
    if (x0 >= end_x)
        return;
    const int n = end_x - x0, vectors = (n + LANES - 1) / LANES;
    const size_t size = (size_t)ny * nx * CHANNELS;
    float strips[STRIP_HEIGHT * STRIP_PITCH];
    vec centre[ALL_VECTORS * CHANNELS], sums[GROUPS * ALL_VECTORS], unseen[GROUPS * ALL_VECTORS];
    vec parts[PATTERNS * ALL_VECTORS], part_unseen[ALL_VECTORS];
    float most[GROUPS], seen[GROUPS];
    int some = 0; /* true if a view sees only some pixels; unseen counts the others */

    for (int j = 0; j < ALL_VECTORS * CHANNELS; ++j)
        centre[j] = (vec)(0.0f);
    for (int q = 0; q < references; ++q) {
        const int k = p * views + reference[q];
        const float4 across = part[2 * k + 1];
        strip(strips, L + view[reference[q]] * size, y + at[k].x - 1,
              (x0 + at[k].y - 1) * CHANNELS, (n + 3) * CHANNELS, part[2 * k], ny, nx);
        for (int r = 0; r < rows; ++r)
            for (int i = 0; i < vectors * CHANNELS; ++i)
                centre[r * ROW_VECTORS * CHANNELS + i]
                    += (vec)(share[q]) * across_taps(across, strips + r * STRIP_PITCH + i * LANES);
    }
    for (int i = 0; i < GROUPS * ALL_VECTORS; ++i)
        sums[i] = (vec)(0.0f);
    for (int j = 0; j < GROUPS; ++j)
        most[j] = seen[j] = 0;

    for (int g = 0; g < patterns; ++g) {
        float whole = 0; /* views that see a pixel */
        int here = 0;    /* true if a view does not see all pixels */
        vec *part_sum = parts + g % PATTERNS * ALL_VECTORS;
        for (int i = 0; i < ALL_VECTORS; ++i)
            part_sum[i] = (vec)(0.0f);
        for (int v = first[g]; v < first[g + 1]; ++v) {
            const int k = p * views + v, top = y + at[k].x, left = x0 + at[k].y;
            const float4 across = part[2 * k + 1];
            const int above = BOUND(-top, 0, rows), below = BOUND(ny - top - reach[k].x, above, rows);
            const int begin = BOUND(-left, 0, n), end = BOUND(nx - left - reach[k].y, begin, n);
            if (above == below || begin == end)
                continue;
            strip(strips, L + view[v] * size, top - 1, (left - 1) * CHANNELS, (n + 3) * CHANNELS,
                  part[2 * k], ny, nx);
            whole += 1;
            if (above == 0 && below == rows && begin == 0 && end == n) {
                for (int r = 0; r < rows; ++r) {
                    const float *from = strips + r * STRIP_PITCH;
                    const vec *middle = centre + r * ROW_VECTORS * CHANNELS;
                    vec *to = part_sum + r * ROW_VECTORS;
                    for (int i = 0; i < vectors; ++i)
                        to[i] += difference(from + i * LANES * CHANNELS, across,
                                            middle + i * CHANNELS, tau);
                }
                continue;
            }
            for (int i = 0; i < GROUPS * ALL_VECTORS && !some; ++i)
                unseen[i] = (vec)(0.0f);
            for (int i = 0; i < ALL_VECTORS && !here; ++i)
                part_unseen[i] = (vec)(0.0f);
            some = here = 1;
            for (int r = 0; r < rows; ++r)
                if (r >= above && r < below)
                    add_part(part_sum + r * ROW_VECTORS, part_unseen + r * ROW_VECTORS,
                             strips + r * STRIP_PITCH, across, centre + r * ROW_VECTORS * CHANNELS,
                             begin, end, vectors, tau);
                else
                    for (int i = 0; i < vectors; ++i)
                        part_unseen[r * ROW_VECTORS + i] += (vec)(1.0f);
        }
        for (int j = 0; j < GROUPS; ++j) {
            const float w = pattern[g * GROUPS + j];
            most[j] += w * (first[g + 1] - first[g]);
            if (w == 0)
                continue;
            seen[j] += w * whole;
            if (here)
                for (int i = 0; i < ALL_VECTORS; ++i)
                    unseen[j * ALL_VECTORS + i] += (vec)(w) * part_unseen[i];
        }
        if (g % PATTERNS == PATTERNS - 1 || g == patterns - 1)
            add_patterns(sums, parts, pattern + (g - g % PATTERNS) * GROUPS, g % PATTERNS + 1);
    }
    for (int r = 0; r < rows; ++r)
        for (int i = 0; i < vectors; ++i) {
            const int k = r * ROW_VECTORS + i, rest = n - LANES * i;
            const vec least = least_mean(sums + k, unseen + k, some, seen, most, tau,
                                         ratio, margin);
            __global float *to = out + row_start(p, y + r, ny, nx) + x0 + LANES * i;
            if (rest >= LANES)
                store(to, least);
            else
                store_some(to, least, rest);
        }
}
