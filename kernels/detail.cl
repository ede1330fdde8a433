/* Energy of the detail of refocused pictures at every pixel, several planes at a time.
 *
 *   detail_energy   out[p, y, x] = sum_c (A[y, x, c] - B[y, x, c])^2
 *                  -DLUMA: (sum_c Y_c (A[y, x, c] - B[y, x, c]))^2
 *   A[y, x, c] = sum_s sum_t ey[|s|] ex[|t|] R[b + p, y + s, x + t, c],   |s|, |t| <= 2
 *   B[y, x, c] = the same with its own weights,                         |s|, |t| <= radius
 *
 * The weights differ from plane to plane: even[p, axis, 3] and low[p, axis, radius + 1].
 * A difference below 1e-5 of B is rounding, not texture, and counts 0. Beyond the edges the picture
 * is reflected.
 * Mapping: a group of items owns `length` samples, whole pixels, of a row (separated.cl), axis 1 = y,
 * axis 2 = p. -DLUMA: 3 channels, weights of Rec. ITU-R BT.709. -DROWS: the group is one item.
 */
#include "separated.cl"

#define ROUNDING 1e-10f

inline float high_pass(const float value, const float low)
{
    const float d = value - low;
    return d * d > ROUNDING * low * low ? d : 0.0f;
}

inline float pixel_energy(__local const float *d, const int channels)
{
#ifdef LUMA
    const float luma = 0.2126f * d[0] + 0.7152f * d[1] + 0.0722f * d[2];
    return luma * luma;
#else
    float sum = 0.0f;
    for (int c = 0; c < channels; ++c)
        sum += d[c] * d[c];
    return sum;
#endif
}

__kernel void detail_energy(__global float *restrict out, __global const float *restrict in,
                           __global const float *restrict even, __global const float *restrict low,
                           const int radius, const int b, const int ny, const int nx,
                           const int channels, const int length, __local float *kept,
                           __local float *blurred, __local float *detail)
{
    const int y = get_global_id(1), p = get_global_id(2);
    const int first = get_group_id(0) * length;
    const int count = min(length, nx * channels - first);
    in += row_start(b + p, 0, ny, nx * channels);
    out += row_start(p, y, ny, nx) + first / channels;
    even += 6 * p;
    low += 2 * (radius + 1) * p;
    columns(kept, in, y, first, count, 2 * channels, even, 2, ny, nx, channels);
    columns(blurred, in, y, first, count, radius * channels, low, radius, ny, nx, channels);
    barrier(CLK_LOCAL_MEM_FENCE);
    kept += 2 * channels;
    blurred += radius * channels;
    even += 3;
    low += radius + 1;
#ifdef ROWS
    float16 A[VECTORS], B[VECTORS];
    FOR_CHUNKS(i, 0, count) {
        across_chunk(A, kept + i, even, 2, channels);
        across_chunk(B, blurred + i, low, radius, channels);
        UNROLLED(j) {
            const float16 d = A[j] - B[j];
            store16_local(detail + i + 16 * j, d * d > ROUNDING * B[j] * B[j] ? d : (float16)(0.0f));
        }
    }
    if (count < CHUNK)
#endif
        FOR_ITEMS(i, count)
            detail[i] = high_pass(across(kept + i, even, 2, channels),
                                  across(blurred + i, low, radius, channels));
    barrier(CLK_LOCAL_MEM_FENCE);
    FOR_ITEMS(x, count / channels)
        out[x] = pixel_energy(detail + x * channels, channels);
}
