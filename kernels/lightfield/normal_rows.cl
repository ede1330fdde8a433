/* normal of refine.cl in vectors, for CPUs and light fields of one or three channels.
 *
 *   A = mean of w (g - <g>)^2, B = mean of w (g - <g>) (r - <r>) + A (d - plane)
 *
 * An item is 16 pixels of a row. Up to MOST_PLANES planes next to the selected pixels, views are shifted to
 * all pixels plane by plane; else pixel by pixel. The sums are vectors of pixels.
 *
 * -DSAMPLE=uchar | ushort | half | float, -DLANES=4 | 8 | 16, -DCHANNELS=1 | 3
 */
#include "common.cl"
#include "vectors.cl"

#define GROUPS 9
#define TERMS (5 + 2 * CHANNELS) /* seen, cost, sum w, sum w g^2, sum w g r; w g and w r */
#define ITEM 16
#define PARTS (ITEM / LANES)
#define MOST_PLANES 5
#define WIDE ((ITEM + 3) * CHANNELS)

typedef union {
    vec v[PARTS];
    float s[ITEM];
} pixels;

typedef union {
    ivec v[PARTS];
    int s[ITEM];
} marks;

typedef struct __attribute__((packed)) { uchar4 v; } four_uchar;
typedef struct __attribute__((packed)) { ushort4 v; } four_ushort;
typedef struct __attribute__((packed)) { float4 v; } four_float;
#define FOUR_uchar(from) convert_float4(((__global const four_uchar *)(from))->v)
#define FOUR_ushort(from) convert_float4(((__global const four_ushort *)(from))->v)
#define FOUR_half(from) vload_half4(0, from)
#define FOUR_float(from) (((__global const four_float *)(from))->v)

/* Tables of a view on a plane. */
typedef struct {
    __global const SAMPLE *view;
    int2 place; /* of the first pixel */
    float4 down, across, down_slope, across_slope;
    float2 step;
    int ny, nx;
} moved;

/* Samples of 16 pixels of a moved view and their derivative by disparity, sample by sample. */
inline void along_row(pixels *value, pixels *slope, const moved *m)
{
    float sum[WIDE + LANES], change[WIDE + LANES];
    const int samples = m->nx * CHANNELS, first = (m->place.y - 1) * CHANNELS;
    const float4 a = m->down, b = m->down_slope;
    __global const SAMPLE *row[4];
#pragma unroll
    for (int t = 0; t < 4; ++t)
        row[t] = m->view + (size_t)BOUND(m->place.x + t - 1, 0, m->ny - 1) * samples;
    if (first >= 0 && first + WIDE <= samples) {
#pragma unroll
        for (int j = 0; j < WIDE; j += LANES) {
            const int i = first + LESS(j, WIDE - LANES), to = i - first;
            const vec p = stored_vec(row[0] + i), q = stored_vec(row[1] + i);
            const vec r = stored_vec(row[2] + i), s = stored_vec(row[3] + i);
            ((loose_vec *)(sum + to))->v
                = (vec)(a.x) * p + (vec)(a.y) * q + (vec)(a.z) * r + (vec)(a.w) * s;
            ((loose_vec *)(change + to))->v
                = (vec)(b.x) * p + (vec)(b.y) * q + (vec)(b.z) * r + (vec)(b.w) * s;
        }
    } else {
        for (int j = 0; j < WIDE; ++j) {
            const int x = BOUND(m->place.y - 1 + j / CHANNELS, 0, m->nx - 1);
            const int i = x * CHANNELS + j % CHANNELS;
            const float p = stored(row[0], i), q = stored(row[1], i);
            const float r = stored(row[2], i), s = stored(row[3], i);
            sum[j] = a.x * p + a.y * q + a.z * r + a.w * s;
            change[j] = b.x * p + b.y * q + b.z * r + b.w * s;
        }
    }
    const float4 c = m->across, d = (float4)(m->step.x) * m->across;
    const float4 e = (float4)(m->step.y) * m->across_slope;
#pragma unroll
    for (int j = 0; j < CHANNELS * PARTS; ++j) {
        vec f = (vec)(0.0f), g = (vec)(0.0f);
#define TAP(t, k) \
        { \
            const vec h = load_own(sum + j * LANES + (k) * CHANNELS); \
            f += (vec)(c.t) * h; \
            g += (vec)(e.t) * h + (vec)(d.t) * load_own(change + j * LANES + (k) * CHANNELS); \
        }
        TAP(x, 0) TAP(y, 1) TAP(z, 2) TAP(w, 3)
        value[j % CHANNELS].v[j / CHANNELS] = f;
        slope[j % CHANNELS].v[j / CHANNELS] = g;
    }
}

/* The channels of pixels, separately. */
inline void by_channel(pixels *value)
{
#if CHANNELS == 3
#pragma unroll
    for (int i = 0; i < PARTS; ++i) {
        const vec a = value[0].v[i], b = value[1].v[i], c = value[2].v[i];
        value[0].v[i] = CHANNEL_0(a, b, c);
        value[1].v[i] = CHANNEL_1(a, b, c);
        value[2].v[i] = CHANNEL_2(a, b, c);
    }
#endif
}

/* Likewise for pixel x alone, channel by channel. */
inline void along_pixel(pixels *value, pixels *slope, const int x, const moved *m)
{
    const int row = m->place.x, column = m->place.y + x;
    const int inside = column >= 1 && column + 2 < m->nx;
    float4 sum[CHANNELS], change[CHANNELS], q[CHANNELS];
#pragma unroll
    for (int c = 0; c < CHANNELS; ++c)
        sum[c] = change[c] = (float4)(0.0f);
#pragma unroll
    for (int t = 0; t < 4; ++t) {
        const float a = t == 0 ? m->down.x : t == 1 ? m->down.y : t == 2 ? m->down.z : m->down.w;
        const float b = t == 0   ? m->down_slope.x
                        : t == 1 ? m->down_slope.y
                        : t == 2 ? m->down_slope.z
                                 : m->down_slope.w;
        __global const SAMPLE *from
            = m->view + (size_t)BOUND(row + t - 1, 0, m->ny - 1) * m->nx * CHANNELS;
        if (inside) {
            from += (column - 1) * CHANNELS;
#pragma unroll
            for (int c = 0; c < CHANNELS; ++c)
                q[c] = JOIN(FOUR_, SAMPLE)(from + 4 * c);
        } else {
            union { float4 v[CHANNELS]; float s[4 * CHANNELS]; } edge;
            for (int i = 0; i < 4 * CHANNELS; ++i)
                edge.s[i] = stored(from, BOUND(column - 1 + i / CHANNELS, 0, m->nx - 1) * CHANNELS
                                             + i % CHANNELS);
            for (int c = 0; c < CHANNELS; ++c)
                q[c] = edge.v[c];
        }
#pragma unroll
        for (int c = 0; c < CHANNELS; ++c) {
            sum[c] += (float4)(a) * q[c];
            change[c] += (float4)(b) * q[c];
        }
    }
#if CHANNELS == 3
#define CHANNELS_OF(v, a, b, c) \
    v[0] = (float4)(a.s03, b.s2, c.s1), v[1] = (float4)(a.s1, b.s03, c.s2), \
    v[2] = (float4)(a.s2, b.s1, c.s03)
    const float4 s0 = sum[0], s1 = sum[1], s2 = sum[2];
    const float4 d0 = change[0], d1 = change[1], d2 = change[2];
    CHANNELS_OF(sum, s0, s1, s2);
    CHANNELS_OF(change, d0, d1, d2);
#endif
#pragma unroll
    for (int c = 0; c < CHANNELS; ++c) {
        const float4 f = m->across * sum[c];
        const float4 g = (float4)(m->step.x) * m->across * change[c]
                         + (float4)(m->step.y) * m->across_slope * sum[c];
        value[c].s[x] = (f.x + f.y) + (f.z + f.w);
        slope[c].s[x] = (g.x + g.y) + (g.z + g.w);
    }
}

/* The planes of 16 pixels. */
typedef struct {
    int count;         /* number of planes */
    int plane[ITEM];   /* distinct planes */
    marks chosen[ITEM]; /* the pixels of each plane */
    marks wanted;
    int of[ITEM];      /* the plane of each pixel */
} choice;

inline choice choose(__global const uchar *wanted, __global const int *nearest, const int n)
{
    choice c;
    c.count = 0;
    for (int x = 0; x < ITEM; ++x) {
        c.wanted.s[x] = x < n && wanted[LESS(x, n - 1)] ? -1 : 0;
        c.of[x] = nearest[LESS(x, n - 1)];
        if (!c.wanted.s[x])
            continue;
        int d = 0;
        while (d < c.count && c.plane[d] != c.of[x])
            ++d;
        if (d == c.count) {
            c.plane[c.count++] = c.of[x];
            for (int i = 0; i < PARTS; ++i)
                c.chosen[d].v[i] = (ivec)(0);
        }
        c.chosen[d].s[x] = -1;
    }
    return c;
}

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void normal_rows(__global float *restrict A, __global float *restrict B,
                          __global const SAMPLE *restrict L, __global const uchar *restrict wanted,
                          __global const float *restrict disparity,
                          __global const int *restrict nearest, __global const float *restrict planes,
                          __global const int *restrict view, __global const float2 *restrict step,
                          __global const int2 *restrict at, __global const float4 *restrict part,
                          __global const float4 *restrict slopes, __global const int2 *restrict reach,
                          __global const int *restrict first, __global const float *restrict pattern,
                          const int patterns, __global const int *restrict reference,
                          __global const float *restrict share, const int references,
                          const int views, const int ny, const int nx, const float tau,
                          const float ratio, const float margin)
{
    const int x0 = get_global_id(0) * ITEM, y = get_global_id(1);
    if (x0 >= nx)
        return;
    const int n = LESS(ITEM, nx - x0);
    const size_t start = row_start(0, y, ny, nx) + x0, size = (size_t)ny * nx * CHANNELS;
    const choice want = choose(wanted + start, nearest + start, n);
    if (want.count == 0)
        return;
    const vec none = (vec)(0.0f), one = (vec)(1.0f), most_cost = (vec)(tau);
    pixels centre[CHANNELS], value[CHANNELS], slope[CHANNELS];
    marks sees;
    vec groups[GROUPS * TERMS * PARTS], terms[TERMS * PARTS];
    float most[GROUPS];

#define MOVED(k, v) \
    { \
        L + view[v] * size, (int2)(y, x0) + at[k], part[2 * (k)], part[2 * (k) + 1], \
            slopes[2 * (k)], slopes[2 * (k) + 1], step[v], ny, nx \
    }
/* View v at all pixels, each on its own plane, and which of them see it. */
#define MOVE(v) \
    for (int i = 0; i < PARTS; ++i) \
        sees.v[i] = (ivec)(0); \
    for (int d = 0; d < want.count && want.count <= MOST_PLANES; ++d) { \
        const int k = want.plane[d] * views + (v); \
        const moved m = MOVED(k, v); \
        pixels on_value[CHANNELS], on_slope[CHANNELS]; \
        along_row(on_value, on_slope, &m); \
        by_channel(on_value); \
        by_channel(on_slope); \
        const int row = m.place.x >= 0 && m.place.x + reach[k].x < ny ? -1 : 0; \
        for (int i = 0; i < PARTS; ++i) { \
            const ivec x = LANE + (ivec)(m.place.y + i * LANES), mark = want.chosen[d].v[i]; \
            sees.v[i] |= mark & (ivec)(row) & (x >= (ivec)(0)) & (x + (ivec)(reach[k].y) < (ivec)(nx)); \
            for (int c = 0; c < CHANNELS; ++c) { \
                value[c].v[i] = mark ? on_value[c].v[i] : value[c].v[i]; \
                slope[c].v[i] = mark ? on_slope[c].v[i] : slope[c].v[i]; \
            } \
        } \
    } \
    for (int x = 0; x < n && want.count > MOST_PLANES; ++x) { \
        if (!want.wanted.s[x]) \
            continue; \
        const int k = want.of[x] * views + (v); \
        const moved m = MOVED(k, v); \
        along_pixel(value, slope, x, &m); \
        sees.s[x] = m.place.x >= 0 && m.place.x + reach[k].x < ny && m.place.y + x >= 0 \
                            && m.place.y + x + reach[k].y < nx \
                        ? -1 \
                        : 0; \
    }

    for (int c = 0; c < CHANNELS; ++c)
        for (int i = 0; i < PARTS; ++i)
            centre[c].v[i] = value[c].v[i] = slope[c].v[i] = none;
    for (int r = 0; r < references; ++r) {
        const int v = reference[r];
        MOVE(v)
        for (int c = 0; c < CHANNELS; ++c)
            for (int i = 0; i < PARTS; ++i)
                centre[c].v[i] += (vec)(share[r]) * value[c].v[i];
    }
    for (int j = 0; j < GROUPS * TERMS * PARTS; ++j)
        groups[j] = none;
    for (int j = 0; j < GROUPS; ++j)
        most[j] = 0;
    for (int g = 0; g < patterns; ++g) {
        for (int t = 0; t < TERMS * PARTS; ++t)
            terms[t] = none;
        for (int v = first[g]; v < first[g + 1]; ++v) {
            MOVE(v)
            for (int i = 0; i < PARTS; ++i) {
                vec e = none, off[CHANNELS], *sum = terms + i * TERMS;
                for (int c = 0; c < CHANNELS; ++c) {
                    off[c] = value[c].v[i] - centre[c].v[i];
                    e += magnitude(off[c]);
                }
                e = e < most_cost ? e : most_cost;
                const vec u = e / most_cost, rest = one - u * u;
                const vec w = sees.v[i] ? rest * rest : none;
                sum[0] += sees.v[i] ? one : none;
                sum[1] += sees.v[i] ? e : none;
                sum[2] += w;
                for (int c = 0; c < CHANNELS; ++c) {
                    const vec pulled = w * slope[c].v[i];
                    sum[3] += pulled * slope[c].v[i];
                    sum[4] += pulled * off[c];
                    sum[5 + c] += pulled;
                    sum[5 + CHANNELS + c] += w * off[c];
                }
            }
        }
        for (int j = 0; j < GROUPS; ++j) {
            const float w = pattern[g * GROUPS + j];
            most[j] += w * (first[g + 1] - first[g]);
            if (w != 0)
                for (int t = 0; t < TERMS * PARTS; ++t)
                    groups[j * TERMS * PARTS + t] += (vec)(w) * terms[t];
        }
    }
    pixels a, b;
    for (int i = 0; i < PARTS; ++i) {
        vec sum[TERMS];
        for (int t = 0; t < TERMS; ++t)
            sum[t] = groups[i * TERMS + t];
        vec least = sum[0] > none ? sum[1] / sum[0] : most_cost;
        for (int j = 1; j < GROUPS; ++j) {
            const vec *group = groups + (j * PARTS + i) * TERMS;
            const vec mean = (vec)(ratio) * group[1] / group[0] + (vec)(margin);
            const ivec better = (group[0] > none) & (group[0] >= (vec)(0.5f * most[j])) & (mean < least);
            least = better ? mean : least;
            for (int t = 0; t < TERMS; ++t)
                sum[t] = better ? group[t] : sum[t];
        }
        const vec weight = sum[2] > none ? sum[2] : one, count = sum[0] > none ? sum[0] : one;
        for (int c = 0; c < CHANNELS; ++c) { /* without a weight these sums are 0 */
            sum[3] -= sum[5 + c] * sum[5 + c] / weight;
            sum[4] -= sum[5 + c] * sum[5 + CHANNELS + c] / weight;
        }
        a.v[i] = (sum[3] > none ? sum[3] : none) / count;
        b.v[i] = sum[4] / count;
    }
    for (int x = 0; x < n; ++x)
        if (want.wanted.s[x]) {
            A[start + x] = a.s[x];
            B[start + x] = b.s[x] + a.s[x] * (disparity[start + x] - planes[want.of[x]]);
        }
}
