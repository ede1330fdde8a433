/* Rows of views for the blocks of shear.cl: copied to local memory, summed for one plane in vectors.
 *
 *   R_v(s) = sum_u w (1 - b_u) L(s) + sum_u w b_u L(s + channels)
 *   out(y) += (1 - b_v) R_v(y) + b_v R_v(y + 1)
 *
 * CHUNK = LANES VECTORS samples of R_v are summed in registers. Views are always summed in one
 * order, so results are bitwise equal from copied rows and, with -DDIRECT, from the light field.
 * -DSAMPLE=, -DLANES=, -DVECTORS=, -DAHEAD, -DDIRECT, -DCHANNELS=: see shear.cl.
 * Included only.
 */
#ifndef CLPLEN_SHEAR_ROWS
#define CLPLEN_SHEAR_ROWS

#include "shear_norm.cl"

#define CHUNK (LANES * VECTORS)
#define LINE_BYTES 64
typedef JOIN(float, LANES) vec;

/* Vectors at any float, instead of vloadn, which PoCL does not inline. */
typedef struct __attribute__((packed)) { vec v; } loose;

static vec load(__local const float *from)
{
    return ((__local const loose *)from)->v;
}

static vec load_global(__global const float *from)
{
    return ((__global const loose *)from)->v;
}

static void store(__local float *to, const vec value)
{
    ((__local loose *)to)->v = value;
}

#ifdef CHANNELS
/* The vector that starts CHANNELS samples further right, from two neighbouring ones. */
#define NEXT_16_1(a, b) (vec)(a.s12345678, a.s9abc, a.sdef, b.s0)
#define NEXT_16_3(a, b) (vec)(a.s3456789a, a.sbcde, a.sf, b.s012)
#define NEXT_8_1(a, b) (vec)(a.s1234, a.s567, b.s0)
#define NEXT_8_3(a, b) (vec)(a.s3456, a.s7, b.s012)
#define NEXT_4_1(a, b) (vec)(a.s123, b.s0)
#define NEXT_4_3(a, b) (vec)(a.s3, b.s012)
#define NEXT(a, b) JOIN(JOIN(JOIN(NEXT_, LANES), _), CHANNELS)(a, b)
#endif

/* Prefetch the samples that are copied next; the range may lie outside, which is harmless. */
#ifdef AHEAD
static void fetch_row(__global const SAMPLE *row, const int n)
{
    for (int i = 0; i < n; i += LINE_BYTES / (int)sizeof(SAMPLE))
        __builtin_prefetch(row + i);
}
#endif

/* n samples of a row of a view from `first` on, which may lie outside. */
static void copy_row(__local float *to, __global const SAMPLE *row,
                     const int first, const int n, const int samples)
{
    const int begin = clamp(-first, 0, n);
    const int end = clamp(samples - first, begin, n);
    for (int i = 0; i < begin; ++i)
        to[i] = 0.0f;
    for (int i = end; i < n; ++i)
        to[i] = 0.0f;
    const int whole = end - (end - begin) % LANES;
    for (int i = begin; i < whole; i += LANES)
        store(to + i, stored_vec(row + first + i));
    for (int i = whole; i < end; ++i)
        to[i] = stored(row, first + i);
}

/* Some vectors of R_v for one plane, added to the two rows of the picture that they belong to
 * (`upper` with b_v, `lower` with 1 - b_v; null outside the block). */
static void add_rows(__local float *upper, __local float *lower, const vec *R, const int vectors,
                     const float blend)
{
    if (lower)
#pragma unroll
        for (int i = 0; i < vectors; ++i)
            store(lower + i * LANES, load(lower + i * LANES) + R[i] * (vec)(1.0f - blend));
    if (upper)
#pragma unroll
        for (int i = 0; i < vectors; ++i)
            store(upper + i * LANES, load(upper + i * LANES) + R[i] * (vec)(blend));
}

#ifndef DIRECT
/* A chunk of R_v for one of several planes, from copied rows of the views. */
static void chunk_of(vec *a, __local const float *views, __local float *second, const int n,
                     const int pitch, const int channels, __global const int *slide,
                     __global const float2 *taps)
{
    vec b[VECTORS];
#pragma unroll
    for (int i = 0; i < VECTORS; ++i)
        a[i] = b[i] = (vec)(0.0f);
    for (int k = 0; k < n; ++k) {
        __local const float *from = views + k * pitch + slide[k];
        const vec first = (vec)(taps[k].x), next = (vec)(taps[k].y);
#pragma unroll
        for (int i = 0; i < VECTORS; ++i) {
            const vec sample = load(from + i * LANES);
            a[i] += sample * first;
            b[i] += sample * next;
        }
    }
    /* Chunks go from right to left, so `second` already stores the following chunk. */
#ifdef CHANNELS
    const vec after = load(second + CHUNK);
    store(second, b[0]);
#pragma unroll
    for (int i = 0; i < VECTORS; ++i)
        a[i] += NEXT(b[i], (i + 1 < VECTORS ? b[i + 1] : after));
#else
#pragma unroll
    for (int i = 0; i < VECTORS; ++i)
        store(second + i * LANES, b[i]);
#pragma unroll
    for (int i = 0; i < VECTORS; ++i)
        a[i] += load(second + i * LANES + channels);
#endif
}

/* Likewise, added to the picture. */
static void sum_chunk(__local float *upper, __local float *lower, __local const float *views,
                      __local float *second, const int n, const int pitch, const int channels,
                      __global const int *slide, __global const float2 *taps, const float blend)
{
    vec a[VECTORS];
    chunk_of(a, views, second, n, pitch, channels, slide, taps);
    add_rows(upper, lower, a, VECTORS, blend);
}

#else
/* Vectors of the only plane, inside all views, from the light field itself: from row (v, y) of view
 * u = 0, that of the next one `view` samples on. Both taps are read: the second time from the
 * nearest cache. The same range of the next row, `ahead` samples on, is prefetched. The
 * sums are bitwise equal to `sum_chunk`. */
#ifdef AHEAD
#define FETCH(row, n) fetch_row(row, n)
#else
#define FETCH(row, n)
#endif
#define FEW 2
#define SUM_STORED(name, N) \
static void name(__local float *upper, __local float *lower, __global const SAMPLE *row, \
                 const int n, const size_t view, const int ahead, const int channels, \
                 __global const int *order, __global const int2 *span, \
                 __global const float2 *taps, const float blend) \
{ \
    vec a[N], b[N]; \
    _Pragma("unroll") for (int i = 0; i < N; ++i) \
        a[i] = b[i] = (vec)(0.0f); \
    for (int k = 0; k < n; ++k) { \
        __global const SAMPLE *from = row + order[k] * view + span[k].x; \
        const vec first = (vec)(taps[k].x), next = (vec)(taps[k].y); \
        FETCH(from + ahead, N * LANES); \
        _Pragma("unroll") for (int i = 0; i < N; ++i) { \
            a[i] += stored_vec(from + i * LANES) * first; \
            b[i] += stored_vec(from + i * LANES + channels) * next; \
        } \
    } \
    _Pragma("unroll") for (int i = 0; i < N; ++i) \
        a[i] += b[i]; \
    add_rows(upper, lower, a, N, blend); \
}
SUM_STORED(sum_many, VECTORS)
SUM_STORED(sum_few, FEW)

/* Likewise for one vector that may lie outside some views, which are copied. */
static void sum_edge(__local float *upper, __local float *lower, __global const SAMPLE *row,
                     __local float *copy, const int n, const size_t view, const int s,
                     const int samples, const int channels, __global const int *order,
                     __global const int2 *span, __global const float2 *taps, const float blend)
{
    vec a = (vec)(0.0f), b = (vec)(0.0f);
    for (int k = 0; k < n; ++k) {
        __global const SAMPLE *from = row + order[k] * view;
        const int first = s + span[k].x;
        if (first >= 0 && first + LANES + channels <= samples) {
            a += stored_vec(from + first) * (vec)(taps[k].x);
            b += stored_vec(from + first + channels) * (vec)(taps[k].y);
        } else {
            copy_row(copy, from, first, LANES + channels, samples);
            a += load(copy) * (vec)(taps[k].x);
            b += load(copy + channels) * (vec)(taps[k].y);
        }
    }
    a += b;
    add_rows(upper, lower, &a, 1, blend);
}
#endif

/* sums /= W for one row of one plane from sample s0 on, 0 where W is 0. */
static void divide_row(__local float *sums, __global const float *norm, const int norm_pitch,
                       const int near, const int far, __global const int *down,
                       __global const float *blend, const int V, const int planes, const int y,
                       const int ny, const int s0, const int width)
{
    const bool inside = all_inside(y, down, blend, V, planes, ny);
    for (int i = 0; i < width; i += LANES) {
        __global const float *here = norm + norm_column(s0 + i, near, far);
        vec used = (vec)(0.0f);
        if (inside)
            used = load_global(here + V * norm_pitch);
        else
            for (int v = 0; v < V; ++v)
                used += load_global(here + v * norm_pitch)
                        * (vec)(row_weight(y, down[v * planes], blend[v * planes], ny));
        const vec mean = load(sums + i) / used;
        store(sums + i, used != (vec)(0.0f) ? mean : (vec)(0.0f));
    }
}

#endif
