/* One magnification of a picture about its middle.
 *
 *   out[y, x, c] = gain sum_ab t(a - py) t(b - px) in[a, b, c],   t(s) = max(1 - |s|, 0)
 *
 * at the position (py, px) = (row_at + row_part, column_at + column_part) of the picture, from
 * tables of integers and fractions made in float64; samples off the picture count 0.
 *
 * Mapping: FOR_X of common.cl over the columns times the channels. -DROWS: see common.cl.
 */
#include "common.cl"

/* Linear between pixels i and i + 1 of a line of n pixels that lie `step` samples apart. */
inline float between(__global const float *restrict line, int i, float part, int n, int step)
{
    const float a = i >= 0 && i < n ? line[i * step] : 0.0f;
    const float b = i >= -1 && i < n - 1 ? line[(i + 1) * step] : 0.0f;
    return a * (1.0f - part) + b * part;
}

__kernel void magnify(__global float *restrict out, __global const float *restrict in,
                      __global const int *restrict row_at, __global const float *restrict row_part,
                      __global const int *restrict column_at,
                      __global const float *restrict column_part, const float gain, const int ny,
                      const int nx, const int channels)
{
    const int y = get_global_id(1);
    const int i = row_at[y];
    const float part = row_part[y];
    const float above = i >= 0 && i < ny ? 1.0f - part : 0.0f;
    const float below = i >= -1 && i < ny - 1 ? part : 0.0f;
    const size_t width = (size_t)nx * channels;
    __global const float *first = in + clamp(i, 0, ny - 1) * width;
    __global const float *second = in + clamp(i + 1, 0, ny - 1) * width;
    FOR_X(s, nx * channels) {
        const int x = s / channels, c = s % channels;
        const int k = column_at[x];
        const float p = column_part[x];
        out[y * width + s] = gain * (above * between(first + c, k, p, nx, channels) +
                                     below * between(second + c, k, p, nx, channels));
    }
}
