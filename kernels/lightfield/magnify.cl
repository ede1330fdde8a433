/* Magnification of a picture about its middle, and its adjoint.
 *
 *   magnify   out[y, x, c] = gain sum_ab t(a - py) t(b - px) in[a, b, c],   t(s) = max(1 - |s|, 0)
 *
 * at the position (py, px) = (row_at + row_part, column_at + column_part) of the picture, from
 * tables of integers and fractions computed in float64; samples off the picture are 0.
 *
 *   spread    out[a, b, c] = gain sum_yx t(a - py[y]) t(b - px[x]) in[y, x, c]
 *
 * from the entries first[a] to first[a + 1] of tables (index, weight) of y, and likewise of x.
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

__kernel void spread(__global float *restrict out, __global const float *restrict in,
                     __global const int *restrict row_first, __global const int *restrict row_index,
                     __global const float *restrict row_weight,
                     __global const int *restrict column_first,
                     __global const int *restrict column_index,
                     __global const float *restrict column_weight, const float gain, const int nx,
                     const int channels)
{
    const int a = get_global_id(1);
    const size_t width = (size_t)nx * channels;
    FOR_X(s, nx * channels) {
        const int b = s / channels, c = s % channels;
        float sum = 0.0f;
        for (int i = row_first[a]; i < row_first[a + 1]; ++i) {
            __global const float *line = in + row_index[i] * width + c;
            float along = 0.0f;
            for (int k = column_first[b]; k < column_first[b + 1]; ++k)
                along += column_weight[k] * line[column_index[k] * channels];
            sum += row_weight[i] * along;
        }
        out[a * width + s] = gain * sum;
    }
}
