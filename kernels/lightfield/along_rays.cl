/* Statistics of the views' samples along the rays that meet on a surface.
 *
 *   f_k(y, x) = L[view[k]] at (y + sy_k, x + sx_k),   c_k = valid share of the taps
 *   mean       out = sum_k w_k c_k f_k / sum_k w_k c_k
 *   variance   out = sum_k w_k c_k (f_k - mean)^2 / sum_k w_k c_k     (West 1979: one pass)
 *   median     out = (a + b)/2, a and b the lowest values at which the sum of w_k c_k up to them
 *              reaches half of the total and exceeds it
 *   extreme    out = sign max_k (sign f_k) over c_k > 0; sign is 1 or -1
 *
 * 0 where no view has any weight. The shift is whole[k] + part[k], 0 <= part < 1, as (x, y); with
 * -DMAP it is part[k] d(y, x), part[k] the pixels for disparity 1. Linear interpolation drops
 * taps outside the view; -DNEAREST reads one sample; -DCUBIC (Keys 1981, a = -1/2) repeats the edge
 * and omits positions outside.
 *
 * One item = one sample of a row (y, x channels + c), or with -DROWS a row in blocks of 16 samples;
 * axis 1 = y.
 *
 * -DSAMPLE=uchar | ushort | half | float   storage type of the light field
 * -DMAP, -DNEAREST, -DCUBIC         see above
 * -DMASK                            samples with mask[view, y, x] = 0 are invalid (not with CUBIC)
 * -DVIEWS=n                         median: capacity in views
 */
#include "common.cl"
#include "stored.cl"

#ifdef ROWS
#define BLOCK 16
#else
#define BLOCK 1
#endif

#ifdef CUBIC
#define TAPS 4
#define FIRST -1
#else
#define TAPS 2
#define FIRST 0
#endif

inline void tap_weights(float *w, const float t)
{
#ifdef CUBIC
    w[0] = ((-0.5f * t + 1.0f) * t - 0.5f) * t;
    w[1] = (1.5f * t - 2.5f) * t * t + 1.0f;
    w[2] = ((-1.5f * t + 2.0f) * t + 0.5f) * t;
    w[3] = (0.5f * t - 0.5f) * t * t;
#elif defined(NEAREST)
    w[0] = t < 0.5f ? 1.0f : 0.0f;
    w[1] = 1.0f - w[0];
#else
    w[0] = 1.0f - t;
    w[1] = t;
#endif
}

/* The sample of channel c at pixel (i + parts.y, j + parts.x), and the share of its taps. */
inline float one_sample(__global const SAMPLE *from, __global const uchar *known, const int i,
                        const int j, const float2 parts, const int c, const int ny, const int nx,
                        const int channels, float *share)
{
    float wy[TAPS], wx[TAPS];
    tap_weights(wy, parts.y);
    tap_weights(wx, parts.x);
    float sum = 0.0f, used = 0.0f;
#ifndef MASK
    if (i + FIRST >= 0 && i + FIRST + TAPS <= ny && j + FIRST >= 0 && j + FIRST + TAPS <= nx) {
        for (int a = 0; a < TAPS; ++a) {
            __global const SAMPLE *row = from + ((i + a + FIRST) * nx + j + FIRST) * channels + c;
            for (int b = 0; b < TAPS; ++b)
                sum += wy[a] * wx[b] * stored(row, b * channels);
        }
        *share = 1.0f;
        return sum;
    }
#endif
    bool whole = true;
#ifdef CUBIC
    whole = i >= 0 && j >= 0 && (i < ny - 1 || (i == ny - 1 && parts.y == 0.0f)) &&
            (j < nx - 1 || (j == nx - 1 && parts.x == 0.0f));
    if (whole)
        for (int a = 0; a < TAPS; ++a)
            for (int b = 0; b < TAPS; ++b)
                sum += wy[a] * wx[b] *
                       stored(from, (clamp(i + a + FIRST, 0, ny - 1) * nx +
                                    clamp(j + b + FIRST, 0, nx - 1)) * channels + c);
#else
    for (int a = 0; a < TAPS; ++a)
        for (int b = 0; b < TAPS; ++b) {
            const float w = wy[a] * wx[b];
            const int y = i + a, x = j + b;
            bool good = w > 0.0f && y >= 0 && y < ny && x >= 0 && x < nx;
#ifdef MASK
            good = good && known[y * nx + x];
#endif
            if (good) {
                sum += w * stored(from, (y * nx + x) * channels + c);
                used += w;
            } else if (w > 0.0f)
                whole = false;
        }
#endif
    *share = whole ? 1.0f : used;
    return whole ? sum : used > 0.0f ? sum / used : 0.0f;
}

/* BLOCK samples of row y of one view from sample s0 on (n of them lie in the picture). */
inline void take(float *value, float *share, __global const SAMPLE *restrict L,
                 __global const uchar *restrict mask, __global const float *restrict d,
                 const int view, const int2 by, const float2 parts, const int y, const int s0,
                 const int n, const int ny, const int nx, const int channels)
{
    const size_t first = (size_t)view * ny * nx;
    __global const SAMPLE *from = L + first * channels;
    __global const uchar *known = mask;
#ifdef MASK
    known += first;
#endif
#if !defined(MAP) && !defined(MASK)
    const int top = y + by.y + FIRST, left = s0 + (by.x + FIRST) * channels;
    if (n == BLOCK && top >= 0 && top + TAPS <= ny && left >= 0 &&
        left + (TAPS - 1) * channels + BLOCK <= nx * channels) {
        float wy[TAPS], wx[TAPS];
        tap_weights(wy, parts.y);
        tap_weights(wx, parts.x);
        for (int i = 0; i < BLOCK; ++i) {
            value[i] = 0.0f;
            share[i] = 1.0f;
        }
        for (int a = 0; a < TAPS; ++a)
            for (int b = 0; b < TAPS; ++b) {
                __global const SAMPLE *row =
                    from + (top + a) * nx * channels + left + b * channels;
                const float w = wy[a] * wx[b];
                for (int i = 0; i < BLOCK; ++i)
                    value[i] += w * stored(row, i);
            }
        return;
    }
#endif
    int x = s0 / channels, c = s0 % channels;
    int2 to = by;
    float2 rest = parts;
    for (int i = 0; i < n; ++i) {
#ifdef MAP
        if (i == 0 || c == 0) {
            const float2 shift = clamp(parts * d[y * nx + x], -1e6f, 1e6f);
            const float2 down = floor(shift);
            to = convert_int2(down);
            rest = shift - down;
        }
#endif
        value[i] = one_sample(from, known, y + to.y, x + to.x, rest, c, ny, nx, channels,
                              share + i);
        if (++c == channels) {
            c = 0;
            ++x;
        }
    }
    for (int i = n; i < BLOCK; ++i)
        value[i] = share[i] = 0.0f;
}

/* Blocks of a row: all with -DROWS, otherwise the item's single sample. */
#ifdef ROWS
#define FOR_BLOCKS(s0, samples) for (int s0 = 0; s0 < (samples); s0 += BLOCK)
#else
#define FOR_BLOCKS(s0, samples) \
    for (int s0 = get_global_id(0); s0 < (samples); s0 = (samples))
#endif
#define TAKE(value, share, k) \
    take(value, share, L, mask, d, view[k], whole[k], part[k], y, s0, n, ny, nx, channels)

__kernel void mean(__global float *restrict out, __global const SAMPLE *restrict L,
                   __global const uchar *restrict mask, __global const float *restrict d,
                   __global const int *restrict view, __global const float *restrict weight,
                   __global const int2 *restrict whole, __global const float2 *restrict part,
                   const int count, const int ny, const int nx, const int channels)
{
    const int y = get_global_id(1), samples = nx * channels;
    FOR_BLOCKS(s0, samples) {
        const int n = min(BLOCK, samples - s0);
        float sum[BLOCK], used[BLOCK], value[BLOCK], share[BLOCK];
        for (int i = 0; i < BLOCK; ++i)
            sum[i] = used[i] = 0.0f;
        for (int k = 0; k < count; ++k) {
            TAKE(value, share, k);
            for (int i = 0; i < BLOCK; ++i) {
                const float w = weight[k] * share[i];
                sum[i] += w * value[i];
                used[i] += w;
            }
        }
        for (int i = 0; i < n; ++i)
            out[row_start(0, y, ny, samples) + s0 + i] = used[i] > 0.0f ? sum[i] / used[i] : 0.0f;
    }
}

__kernel void variance(__global float *restrict out, __global const SAMPLE *restrict L,
                       __global const uchar *restrict mask, __global const float *restrict d,
                       __global const int *restrict view, __global const float *restrict weight,
                       __global const int2 *restrict whole, __global const float2 *restrict part,
                       const int count, const int ny, const int nx, const int channels)
{
    const int y = get_global_id(1), samples = nx * channels;
    FOR_BLOCKS(s0, samples) {
        const int n = min(BLOCK, samples - s0);
        float average[BLOCK], spread[BLOCK], used[BLOCK], value[BLOCK], share[BLOCK];
        for (int i = 0; i < BLOCK; ++i)
            average[i] = spread[i] = used[i] = 0.0f;
        for (int k = 0; k < count; ++k) {
            TAKE(value, share, k);
            for (int i = 0; i < BLOCK; ++i) {
                const float w = weight[k] * share[i];
                const float all = used[i] + w;
                const float away = value[i] - average[i];
                const float moved = all > 0.0f ? away * w / all : 0.0f;
                spread[i] += used[i] * away * moved;
                average[i] += moved;
                used[i] = all;
            }
        }
        for (int i = 0; i < n; ++i)
            out[row_start(0, y, ny, samples) + s0 + i] =
                used[i] > 0.0f ? spread[i] / used[i] : 0.0f;
    }
}

__kernel void extreme(__global float *restrict out, __global const SAMPLE *restrict L,
                      __global const uchar *restrict mask, __global const float *restrict d,
                      __global const int *restrict view, __global const float *restrict weight,
                      __global const int2 *restrict whole, __global const float2 *restrict part,
                      const int count, const int ny, const int nx, const int channels,
                      const float sign)
{
    const int y = get_global_id(1), samples = nx * channels;
    FOR_BLOCKS(s0, samples) {
        const int n = min(BLOCK, samples - s0);
        float best[BLOCK], value[BLOCK], share[BLOCK];
        for (int i = 0; i < BLOCK; ++i)
            best[i] = -INFINITY;
        for (int k = 0; k < count; ++k) {
            TAKE(value, share, k);
            for (int i = 0; i < BLOCK; ++i)
                best[i] = share[i] > 0.0f ? max(best[i], sign * value[i]) : best[i];
        }
        for (int i = 0; i < n; ++i)
            out[row_start(0, y, ny, samples) + s0 + i] =
                best[i] > -INFINITY ? sign * best[i] : 0.0f;
    }
}

#ifdef VIEWS
/* Order-preserving conversion of floats to integers, and back. */
inline uint key_of(const float value)
{
    const uint bits = as_uint(value);
    return bits & 0x80000000u ? ~bits : bits | 0x80000000u;
}

inline float value_of(const uint key)
{
    return as_float(key & 0x80000000u ? key & 0x7fffffffu : ~key);
}

__kernel void median(__global float *restrict out, __global const SAMPLE *restrict L,
                     __global const uchar *restrict mask, __global const float *restrict d,
                     __global const int *restrict view, __global const float *restrict weight,
                     __global const int2 *restrict whole, __global const float2 *restrict part,
                     const int count, const int ny, const int nx, const int channels)
{
    const int y = get_global_id(1), samples = nx * channels;
    uint keys[VIEWS * BLOCK];
    float weights[VIEWS * BLOCK];
    FOR_BLOCKS(s0, samples) {
        const int n = min(BLOCK, samples - s0);
        float half_of[BLOCK], value[BLOCK], share[BLOCK];
        for (int i = 0; i < BLOCK; ++i)
            half_of[i] = 0.0f;
        for (int k = 0; k < count; ++k) {
            TAKE(value, share, k);
            for (int i = 0; i < BLOCK; ++i) {
                keys[k * BLOCK + i] = key_of(value[i]);
                weights[k * BLOCK + i] = weight[k] * share[i];
                half_of[i] += weight[k] * share[i] / 2;
            }
        }
        uint low[BLOCK], high[BLOCK], after[BLOCK];
        float sum[BLOCK];
        for (int i = 0; i < BLOCK; ++i) {
            low[i] = 0u;
            high[i] = after[i] = 0xffffffffu;
        }
        for (int bit = 0; bit < 33; ++bit) {  /* the last pass sums the weights up to `low` */
            for (int i = 0; i < BLOCK; ++i)
                sum[i] = 0.0f;
            for (int k = 0; k < count; ++k)
                for (int i = 0; i < BLOCK; ++i) {
                    const uint middle = low[i] + (high[i] - low[i]) / 2;
                    sum[i] += keys[k * BLOCK + i] <= middle ? weights[k * BLOCK + i] : 0.0f;
                }
            for (int i = 0; i < BLOCK; ++i) {
                const uint middle = low[i] + (high[i] - low[i]) / 2;
                const bool enough = sum[i] >= half_of[i];
                high[i] = enough ? middle : high[i];
                low[i] = enough ? low[i] : min(middle + 1u, high[i]);
            }
        }
        for (int k = 0; k < count; ++k)
            for (int i = 0; i < BLOCK; ++i) {
                const uint key = keys[k * BLOCK + i];
                const bool above = key > low[i] && weights[k * BLOCK + i] > 0.0f;
                after[i] = above ? min(after[i], key) : after[i];
            }
        for (int i = 0; i < n; ++i) {
            const uint next = sum[i] > half_of[i] || after[i] == 0xffffffffu ? low[i] : after[i];
            const float middle = (value_of(low[i]) + value_of(next)) / 2;
            out[row_start(0, y, ny, samples) + s0 + i] = half_of[i] > 0.0f ? middle : 0.0f;
        }
    }
}
#endif
