/* A symmetric filter along y, then along x, for a stretch of one row in local memory.
 *
 *   column(i)    = sum_s w[|s|] in[y + s, i]             -radius <= s <= radius
 *   across(i)    = sum_t w[|t|] column(i + t channels)
 *
 * i is a sample of a row, channels fastest; beyond the edges the picture is reflected:
 * d c b a | a b c d | d c b a.
 *
 * A group of items owns `length` samples of LINES rows; its local memory stores them with `halo`
 * samples on either side, row by row. w points at the weight at distance 0 of a table of all
 * distances, with LINES - 1 zeros at either end, so that each row is read once for all rows.
 * -DSAMPLE=uchar | ushort | half | float: storage type of `in`; default float32. -DLANES=4 | 8 | 16
 * -DLINES=n; -DROWS: the group is one item, which takes LANES samples at a time. Otherwise LINES is 1.
 * Included only.
 */
#ifndef CLPLEN_SEPARATED
#define CLPLEN_SEPARATED
#include "common.cl"
#include "vectors.cl"

#ifdef SAMPLE
#define SOURCE SAMPLE
#define SOURCE_AT(in, i) stored(in, i)
#define SOURCE_VEC(in) stored_vec(in)
#else
#define SOURCE float
#define SOURCE_AT(in, i) ((in)[i])
#define SOURCE_VEC(in) load(in)
#endif

#define VECTORS 4
#define DOWN 2 /* vectors of a row of the LINES that are filtered at a time */
#define CHUNK (LANES * VECTORS)
#define UNROLLED(j) _Pragma("unroll") for (int j = 0; j < VECTORS; ++j)
#define EACH_LINE(r) _Pragma("unroll") for (int r = 0; r < LINES; ++r)
#define EACH_DOWN(j) _Pragma("unroll") for (int j = 0; j < DOWN; ++j)
/* Chunks of begin <= i < end, the last one overlapping; none if the range is shorter. */
#define FOR_CHUNKS(i, begin, end, chunk) \
    for (int i = (begin); i < (end) && (end) - (begin) >= (chunk); \
         i = i + (chunk) < (end) && i + 2 * (chunk) > (end) ? (end) - (chunk) : i + (chunk))
#define FOR_ITEMS(i, n) for (int i = get_local_id(0); i < (n); i += get_local_size(0))

inline int reflected(int i, const int n)
{
    if (i >= 0 && i < n)
        return i;
    i %= 2 * n;
    i += i < 0 ? 2 * n : 0;
    return i < n ? i : 2 * n - 1 - i;
}

inline float column(__global const SOURCE *in, const int y, const int i, __global const float *w,
                    const int radius, const int ny, const int n)
{
    float sum = 0.0f;
    for (int t = -radius; t <= radius; ++t)
        sum += w[t] * SOURCE_AT(in, row_start(0, reflected(y + t, ny), ny, n) + i);
    return sum;
}

#ifdef ROWS
/* Likewise for rows y ... y + LINES - 1, `apart` samples apart in `to`, and LANES DOWN samples from i
 * on. */
inline void column_chunk(__local float *to, const int apart, __global const SOURCE *in, const int y,
                         const int i, __global const float *w, const int radius, const int ny,
                         const int n)
{
    vec sum[LINES][DOWN];
    EACH_LINE(r) EACH_DOWN(j)
        sum[r][j] = (vec)(0.0f);
    for (int t = -radius; t < LINES + radius; ++t) {
        __global const SOURCE *at = in + row_start(0, reflected(y + t, ny), ny, n) + i;
        vec v[DOWN];
        EACH_DOWN(j)
            v[j] = SOURCE_VEC(at + LANES * j);
        EACH_LINE(r) EACH_DOWN(j)
            sum[r][j] += w[t - r] * v[j];
    }
    EACH_LINE(r) EACH_DOWN(j)
        store_local(to + r * apart + LANES * j, sum[r][j]);
}
#endif

/* Sample i of a row, which may lie outside. */
inline int reflected_sample(const int i, const int nx, const int channels)
{
    const int x = i >= 0 ? i / channels : -((channels - 1 - i) / channels);
    return reflected(x, nx) * channels + (i - x * channels);
}

/* column(first - halo) ... column(first + count + halo - 1) of LINES rows, `apart` apart in `to`. */
inline void columns(__local float *to, const int apart, __global const SOURCE *in, const int y,
                    const int first, const int count, const int halo, __global const float *w,
                    const int radius, const int ny, const int nx, const int channels)
{
    const int n = nx * channels;
    const int start = first - halo;
#ifdef ROWS
    const int begin = max(start, 0), end = min(first + count + halo, n);
    FOR_CHUNKS(i, begin, end, LANES * DOWN)
        column_chunk(to + i - start, apart, in, y, i, w, radius, ny, n);
    for (int r = 0; r < LINES; ++r) {
        __local float *line = to + r * apart;
        if (end - begin < LANES * DOWN)
            for (int i = begin; i < end; ++i)
                line[i - start] = column(in, y + r, i, w, radius, ny, n);
        for (int i = start; i < begin; ++i)
            line[i - start] = line[reflected_sample(i, nx, channels) - start];
        for (int i = end; i < first + count + halo; ++i)
            line[i - start] = line[reflected_sample(i, nx, channels) - start];
    }
#else
    FOR_ITEMS(k, count + 2 * halo)
        to[k] = column(in, y, reflected_sample(start + k, nx, channels), w, radius, ny, n);
#endif
}

inline float across(__local const float *at, __global const float *w, const int radius,
                    const int channels)
{
    float sum = w[0] * at[0];
    for (int t = 1; t <= radius; ++t)
        sum += w[t] * (at[-t * channels] + at[t * channels]);
    return sum;
}

#ifdef ROWS
/* Likewise for CHUNK samples from `at` on. */
inline void across_chunk(vec sum[VECTORS], __local const float *at, __global const float *w,
                         const int radius, const int channels)
{
    UNROLLED(j)
        sum[j] = w[0] * load_local(at + LANES * j);
    for (int t = 1; t <= radius; ++t) {
        __local const float *before = at - t * channels, *after = at + t * channels;
        UNROLLED(j)
            sum[j] += w[t] * (load_local(before + LANES * j) + load_local(after + LANES * j));
    }
}
#endif

#endif
