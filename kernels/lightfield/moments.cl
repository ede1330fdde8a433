/* Mean and variance over the views of a light field sheared by planes.
 *
 *   l_n(y, s)        = value of view n, moved by the plane's constant (sheared.cl), c_n its share inside
 *   mean[p, y, s]    = sum_n w_n c_n l_n / W,   W = sum_n w_n c_n
 *   variance[p, y, s] = sum_n w_n c_n (l_n - mean)^2 / W = S2 - S1^2
 *
 * S1 and S2 are moments about the sample of one view near the middle, which avoids most of the
 * cancellation in S2 - S1^2. A variance below (1e-5 mean)^2 is rounding and is set to 0, as
 * without any weight.
 *
 * place[p, n] = (view, integer shift along y, along x, 0);  part[p, n] = (their fractions, w_n, 0).
 * moments          an item = LANES VECTORS samples of a row of one plane, in the order of
 *                  sheared.cl; for GPUs.
 * moments_blocks   an item = as many samples of HEIGHT rows of all planes; for CPUs. Their part
 *                  of a view is copied to local memory, with its edges, and read for every plane.
 *                  low[n] = integer shifts (y, x) of the topmost and the leftmost plane, span[n]
 *                  the range of the others beyond.
 *
 * -DSAMPLE=uchar | ushort | half | float, -DLANES=1 | 4 | 8 | 16, -DVECTORS=n: see sheared.cl.
 * -DHEIGHT=n: moments_blocks.
 */
#include "sheared.cl"

#define ROUNDING 1e-10f

__kernel void moments(__global float *restrict mean, __global float *restrict variance,
                      __global const SAMPLE *restrict L, __global const int4 *restrict place,
                      __global const float4 *restrict part, const int views, const int middle,
                      __global const int2 *restrict edge, const int reach, const int ny,
                      const int nx, const int channels)
{
    const view_size size = {ny, nx, channels, nx * channels, edge + reach};
    const int p = get_global_id(1 - SAMPLE_AXIS), y = get_global_id(2);
    const int s = get_global_id(SAMPLE_AXIS) * LANES * VECTORS;
    if (s >= size.n)
        return;
    const view_rows centre = moved(L, (int4)(middle, 0, 0, 0), (float4)(0.0f), y, size);
    vec pivot[VECTORS], W[VECTORS], S1[VECTORS], S2[VECTORS];
    EACH_VECTOR(j) {
        pivot[j] = value(centre, s + LANES * j, size);
        W[j] = S1[j] = S2[j] = (vec)(0.0f);
    }
    for (int n = p * views; n < (p + 1) * views; ++n) {
        const view_rows rows = moved(L, place[n], part[n], y, size);
        const float share = part[n].z * rows.share;
        if (within(rows, s, LANES * VECTORS, size)) {
            EACH_VECTOR(j) {
                const vec l = value_within(rows, s + LANES * j, size) - pivot[j];
                W[j] += share;
                S1[j] += share * l;
                S2[j] += share * l * l;
            }
        } else {
            for (int j = 0; j < VECTORS; ++j) {
                const vec l = value(rows, s + LANES * j, size) - pivot[j];
                const vec w = part[n].z * inside(rows, s + LANES * j, size);
                W[j] += w;
                S1[j] += w * l;
                S2[j] += w * l * l;
            }
        }
    }
    const size_t row = row_start(p, y, ny, size.n);
    EACH_VECTOR(j) {
        const vec some = W[j] > 0.0f ? W[j] : (vec)(1.0f);
        const vec m = S1[j] / some;
        const vec v = S2[j] / some - m * m;
        const vec whole = W[j] > 0.0f ? m + pivot[j] : (vec)(0.0f);
        store_row(mean + row, whole, s + LANES * j, size.n);
        store_row(variance + row, v > ROUNDING * whole * whole ? v : (vec)(0.0f), s + LANES * j,
                  size.n);
    }
}

#ifdef HEIGHT
#define CHUNK (LANES * VECTORS)  /* samples of a block's row */
typedef struct __attribute__((packed)) { vec v; } loose_local;

inline vec load(__local const float *from)
{
    return ((__local const loose_local *)from)->v;
}

inline void store(__local float *to, const vec v)
{
    ((__local loose_local *)to)->v = v;
}

/* `count` samples from s on of one row of a view, samples outside repeat its edge. */
inline void copy_row(__local float *to, __global const SAMPLE *row, const int s, const int count,
                     const view_size size)
{
    const int begin = clamp(-s, 0, count), end = clamp(size.n - s, begin, count);
    const int whole = end - (end - begin) % LANES;
    for (int i = 0; i < begin; ++i)
        to[i] = stored(row, size.edge[s + i].x);
    for (int i = begin; i < whole; i += LANES)
        store(to + i, stored_vec(row + s + i));
    for (int i = whole; i < end; ++i)
        to[i] = stored(row, s + i);
    for (int i = end; i < count; ++i)
        to[i] = stored(row, size.edge[s + i].x);
}

/* One view of one plane: `from` is its sample (y0, s0), share[] its share along x. */
inline void add_view(__local float *W, __local float *S1, __local float *S2,
                     __local const float *pivot, __local const float *from, const int pitch,
                     __local const float *share, const int rows, const int top, const float weight,
                     const float2 part, const view_size size)
{
    const vec across = (vec)(part.y), down = (vec)(part.x);
    vec above[VECTORS];
    EACH_VECTOR(j) {
        const vec a = load(from + j * LANES);
        above[j] = a + across * (load(from + j * LANES + size.channels) - a);
    }
    for (int r = 0; r < rows; ++r) {
        __local const float *next = from + (r + 1) * pitch;
        const vec inside = (vec)(share_of(top + r, part.x, size.ny));
        EACH_VECTOR(j) {
            const int at = r * CHUNK + j * LANES;
            const vec c = load(next + j * LANES);
            const vec below = c + across * (load(next + j * LANES + size.channels) - c);
            const vec l = above[j] + down * (below - above[j]) - load(pivot + at);
            const vec w = weight * (inside * load(share + j * LANES));
            store(W + at, load(W + at) + w);
            store(S1 + at, load(S1 + at) + w * l);
            store(S2 + at, load(S2 + at) + w * l * l);
            above[j] = below;
        }
    }
}

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void moments_blocks(__global float *restrict mean, __global float *restrict variance,
                             __global const SAMPLE *restrict L, __global const int4 *restrict place,
                             __global const float4 *restrict part, const int views,
                             const int middle, __global const int2 *restrict low,
                             __global const int2 *restrict span, const int planes, const int pitch,
                             __local float *sums, __local float *rows_of_view,
                             __global const int2 *restrict edge, const int reach, const int ny,
                             const int nx, const int channels)
{
    const view_size size = {ny, nx, channels, nx * channels, edge + reach};
    const int s0 = get_global_id(0) * CHUNK, y0 = get_global_id(1) * HEIGHT;
    const int rows = min(HEIGHT, ny - y0), block = HEIGHT * CHUNK;
    __local float *pivot = sums + 3 * planes * block, *share = pivot + block;
    for (int i = 0; i < 3 * planes * block; i += LANES)
        store(sums + i, (vec)(0.0f));
    for (int r = 0; r < rows; ++r)
        copy_row(pivot + r * CHUNK, L + row_start(middle, y0 + r, ny, size.n), s0, CHUNK, size);
    bool ones = false;  /* true if share[] is 1 throughout */
    for (int n = 0; n < views; ++n) {
        const int top = y0 + low[n].x, first = s0 + low[n].y * channels;
        const int wide = CHUNK + (span[n].y + 1) * channels;
        for (int r = 0; r <= rows + span[n].x; ++r)
            copy_row(rows_of_view + r * pitch,
                     L + row_start(place[n].x, nearest(top + r, ny), ny, size.n), first, wide, size);
        for (int p = 0; p < planes; ++p) {
            const int4 where = place[p * views + n];
            const float4 how = part[p * views + n];
            const int s = s0 + where.z * channels;
            const bool whole = s >= 0 && s + channels + CHUNK <= size.n;
            if (whole && !ones)
                for (int i = 0; i < CHUNK; i += LANES)
                    store(share + i, (vec)(1.0f));
            else if (!whole)
                for (int i = 0; i < CHUNK; ++i)
                    share[i] = share_of(size.edge[s + i].y, how.y, nx);
            ones = whole;
            add_view(sums + p * block, sums + (planes + p) * block, sums + (2 * planes + p) * block,
                     pivot, rows_of_view + (where.y - low[n].x) * pitch
                            + (where.z - low[n].y) * channels, pitch, share, rows, y0 + where.y,
                     how.z, how.xy, size);
        }
    }
    for (int p = 0; p < planes; ++p)
        for (int r = 0; r < rows; ++r)
            for (int i = 0; i < CHUNK; i += LANES) {
                const int at = p * block + r * CHUNK + i;
                const vec W = load(sums + at), some = W > 0.0f ? W : (vec)(1.0f);
                const vec m = load(sums + planes * block + at) / some;
                const vec v = load(sums + 2 * planes * block + at) / some - m * m;
                const vec whole = W > 0.0f ? m + load(pivot + r * CHUNK + i) : (vec)(0.0f);
                const size_t row = row_start(p, y0 + r, ny, size.n);
                store_row(mean + row, whole, s0 + i, size.n);
                store_row(variance + row, v > ROUNDING * whole * whole ? v : (vec)(0.0f), s0 + i,
                          size.n);
            }
}
#endif
