/* Gaussian blur of one picture (y, x, c) of a batch, one axis at a time.
 *
 *   gaussian_x   out[y, x, c] = sum_t w[|t|] in[b, y, x + t, c],   -radius <= t <= radius
 *   gaussian_y   out[y, x, c] = sum_t w[|t|] in[b, y + t, x, c]
 *
 * Beyond the edges the picture is reflected: d c b a | a b c d | d c b a, as often as needed.
 * Mapping: FOR_X of common.cl over x = samples of a row, n = nx channels; no batch axis.
 * -DROWS: 16 samples at a time where no reflection is needed.
 */
#include "common.cl"

inline int reflected(int i, const int n)
{
    if (i >= 0 && i < n)
        return i;
    i %= 2 * n;
    i += i < 0 ? 2 * n : 0;
    return i < n ? i : 2 * n - 1 - i;
}

inline float blurred_x(__global const float *in, const int i, __global const float *w,
                       const int radius, const int nx, const int channels)
{
    const int x = i / channels;
    float sum = w[0] * in[i];
    for (int t = 1; t <= radius; ++t) {
        const int before = i + (reflected(x - t, nx) - x) * channels;
        const int after = i + (reflected(x + t, nx) - x) * channels;
        sum += w[t] * (in[before] + in[after]);
    }
    return sum;
}

inline float blurred_y(__global const float *in, const int y, const int i, __global const float *w,
                       const int radius, const int ny, const int n)
{
    float sum = w[0] * in[row_start(0, y, ny, n) + i];
    for (int t = 1; t <= radius; ++t) {
        const size_t before = row_start(0, reflected(y - t, ny), ny, n) + i;
        const size_t after = row_start(0, reflected(y + t, ny), ny, n) + i;
        sum += w[t] * (in[before] + in[after]);
    }
    return sum;
}

__kernel void gaussian_x(__global float *restrict out, __global const float *restrict in,
                         __global const float *restrict w, const int radius, const int b,
                         const int ny, const int nx, const int channels)
{
    const int y = get_global_id(1);
    const int n = nx * channels;
    in += row_start(b, y, ny, n);
    out += row_start(0, y, ny, n);
#ifdef ROWS
    const int edge = min(radius * channels, n);
    int i = 0;
    for (; i < edge; ++i)
        out[i] = blurred_x(in, i, w, radius, nx, channels);
    for (; i + 16 <= n - edge; i += 16) {
        float16 sum = w[0] * vload16(0, in + i);
        for (int t = 1; t <= radius; ++t)
            sum += w[t] * (vload16(0, in + i - t * channels) + vload16(0, in + i + t * channels));
        vstore16(sum, 0, out + i);
    }
    for (; i < n; ++i)
        out[i] = blurred_x(in, i, w, radius, nx, channels);
#else
    FOR_X(i, n)
        out[i] = blurred_x(in, i, w, radius, nx, channels);
#endif
}

__kernel void gaussian_y(__global float *restrict out, __global const float *restrict in,
                         __global const float *restrict w, const int radius, const int b,
                         const int ny, const int nx, const int channels)
{
    const int y = get_global_id(1);
    const int n = nx * channels;
    in += row_start(b, 0, ny, n);
    out += row_start(0, y, ny, n);
#ifdef ROWS
    int i = 0;
    for (; i + 16 <= n; i += 16) {
        float16 sum = w[0] * vload16(0, in + row_start(0, y, ny, n) + i);
        for (int t = 1; t <= radius; ++t) {
            const size_t before = row_start(0, reflected(y - t, ny), ny, n) + i;
            const size_t after = row_start(0, reflected(y + t, ny), ny, n) + i;
            sum += w[t] * (vload16(0, in + before) + vload16(0, in + after));
        }
        vstore16(sum, 0, out + i);
    }
    for (; i < n; ++i)
        out[i] = blurred_y(in, y, i, w, radius, ny, n);
#else
    FOR_X(i, n)
        out[i] = blurred_y(in, y, i, w, radius, ny, n);
#endif
}
