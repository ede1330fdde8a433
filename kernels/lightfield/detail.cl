/* Energy of the detail of refocused pictures at every pixel, several planes at a time.
 *
 *   detail_energy   out[p, y, x] = sum_c (A[y, x, c] - B[y, x, c])^2
 *                  -DLUMA: (sum_c Y_c (A[y, x, c] - B[y, x, c]))^2
 *   A[y, x, c] = sum_s sum_t ey[|s|] ex[|t|] R[q, y + s, x + t, c],  q = b + p,   |s|, |t| <= 2
 *   B[y, x, c] = likewise with other weights,                           |s|, |t| <= radius
 *
 * The weights differ from plane to plane: tables of separated.cl, even[q, axis, ] and low[q, axis, ].
 * A difference below 1e-5 of B is rounding and is set to 0. Beyond the edges the picture
 * is reflected.
 * Mapping: a group of items owns `length` samples, whole pixels, of LINES rows (separated.cl), axis
 * 1 = y / LINES, axis 2 = p. -DCHANNELS=n; -DLUMA: 3 channels, weights of Rec. ITU-R BT.709.
 * -DLINES=n, -DLANES=4 | 8 | 16; -DROWS: the group is one item.
 */
#include "separated.cl"

#define ROUNDING 1e-10f

inline float high_pass(const float value, const float low)
{
    const float d = value - low;
    return d * d > ROUNDING * low * low ? d : 0.0f;
}

inline float pixel_energy(__local const float *d)
{
#ifdef LUMA
    const float luma = 0.2126f * d[0] + 0.7152f * d[1] + 0.0722f * d[2];
    return luma * luma;
#else
    float sum = 0.0f;
    for (int c = 0; c < CHANNELS; ++c)
        sum += d[c] * d[c];
    return sum;
#endif
}

#ifdef ROWS
/* A row of `count` samples: A - B, and its energy. */
inline void row_energy(__global float *out, __local const float *kept, __local const float *blurred,
                       __global const float *even, __global const float *low, const int radius,
                       const int count, __local float *detail)
{
    vec A[VECTORS], B[VECTORS];
    FOR_CHUNKS(i, 0, count, CHUNK) {
        across_chunk(A, kept + i, even, 2, CHANNELS);
        across_chunk(B, blurred + i, low, radius, CHANNELS);
        UNROLLED(j) {
            const vec d = A[j] - B[j];
            const vec clear = d * d > ROUNDING * B[j] * B[j] ? d : (vec)(0.0f);
#if CHANNELS == 1
            store(out + i + LANES * j, clear * clear);
#else
            store_local(detail + i + LANES * j, clear);
#endif
        }
    }
    if (count < CHUNK)
        for (int i = 0; i < count; ++i)
            detail[i] = high_pass(across(kept + i, even, 2, CHANNELS),
                                  across(blurred + i, low, radius, CHANNELS));
    if (CHANNELS > 1 || count < CHUNK)
        for (int x = 0; x < count / CHANNELS; ++x)
            out[x] = pixel_energy(detail + x * CHANNELS);
}
#endif

__kernel void detail_energy(__global float *restrict out, __global const float *restrict in,
                           __global const float *restrict even, __global const float *restrict low,
                           const int radius, const int b, const int ny, const int nx,
                           const int length, __local float *kept, __local float *blurred,
                           __local float *detail)
{
    const int y = get_global_id(1) * LINES, p = get_global_id(2);
    const int first = get_group_id(0) * length;
    const int count = min(length, nx * CHANNELS - first);
    const int near = 2 * (2 + LINES) - 1, far = 2 * (radius + LINES) - 1; /* sizes of two tables */
    in += row_start(b + p, 0, ny, nx * CHANNELS);
    out += row_start(p, y, ny, nx) + first / CHANNELS;
    even += 2 * near * (b + p) + 2 + LINES - 1;
    low += 2 * far * (b + p) + radius + LINES - 1;
    const int narrow = length + 4 * CHANNELS, wide = length + 2 * radius * CHANNELS;
    columns(kept, narrow, in, y, first, count, 2 * CHANNELS, even, 2, ny, nx, CHANNELS);
    columns(blurred, wide, in, y, first, count, radius * CHANNELS, low, radius, ny, nx, CHANNELS);
    barrier(CLK_LOCAL_MEM_FENCE);
    kept += 2 * CHANNELS;
    blurred += radius * CHANNELS;
    even += near;
    low += far;
#ifdef ROWS
    for (int r = 0; r < min(LINES, ny - y); ++r)
        row_energy(out + r * nx, kept + r * narrow, blurred + r * wide, even, low, radius, count,
                   detail);
#else
    FOR_ITEMS(i, count)
        detail[i] = high_pass(across(kept + i, even, 2, CHANNELS),
                              across(blurred + i, low, radius, CHANNELS));
    barrier(CLK_LOCAL_MEM_FENCE);
    FOR_ITEMS(x, count / CHANNELS)
        out[x] = pixel_energy(detail + x * CHANNELS);
#endif
}
