/* How sharp one picture of a focal stack is at every pixel.
 *
 *   even           out[y, x, c] = sum_s sum_t wy[|s|] wx[|t|] R[b, y + s, x + t, c],
 *                  |s|, |t| <= 2; beyond the edges the nearest; FOR_X over the row's samples
 *   local_energy   out[y, x] = sum_c (R[y, x, c] - low[y, x, c])^2
 *                  -DLUMA: (sum_c Y_c (R[y, x, c] - low[y, x, c]))^2
 *
 * A difference below 1e-5 of the smoothed value is rounding, not texture, and counts 0.
 * Mapping: FOR_X of common.cl; no batch axis. -DLUMA: 3 channels, weights of Rec. ITU-R BT.709.
 * -DROWS: `even` takes 16 samples at a time inside the edges.
 */
#include "common.cl"

#define ROUNDING 1e-5f

inline float column(__global const float *const rows[5], const int i, const float3 w)
{
    return w.x * rows[2][i] + w.y * (rows[1][i] + rows[3][i]) + w.z * (rows[0][i] + rows[4][i]);
}

inline float evened(__global const float *const rows[5], const int i, const float3 wy,
                           const float3 wx, const int nx, const int channels)
{
    const int x = i / channels;
    float sum = wx.x * column(rows, i, wy);
    for (int t = 1; t <= 2; ++t) {
        const int before = i - min(t, x) * channels;
        const int after = i + min(t, nx - 1 - x) * channels;
        sum += (t == 1 ? wx.y : wx.z) * (column(rows, before, wy) + column(rows, after, wy));
    }
    return sum;
}

#ifdef ROWS
inline float16 column16(__global const float *const rows[5], const int i, const float3 w)
{
    return w.x * vload16(0, rows[2] + i) +
           w.y * (vload16(0, rows[1] + i) + vload16(0, rows[3] + i)) +
           w.z * (vload16(0, rows[0] + i) + vload16(0, rows[4] + i));
}
#endif

__kernel void even(__global float *restrict out, __global const float *restrict in,
                   const float wy0, const float wy1, const float wy2, const float wx0,
                   const float wx1, const float wx2, const int b, const int ny, const int nx,
                   const int channels)
{
    const int y = get_global_id(1);
    const int n = nx * channels;
    const float3 wy = (float3)(wy0, wy1, wy2), wx = (float3)(wx0, wx1, wx2);
    __global const float *rows[5];
    for (int s = 0; s < 5; ++s)
        rows[s] = in + row_start(b, clamp(y + s - 2, 0, ny - 1), ny, n);
    out += row_start(0, y, ny, n);
#ifdef ROWS
    const int edge = min(2 * channels, n);
    int i = 0;
    for (; i < edge; ++i)
        out[i] = evened(rows, i, wy, wx, nx, channels);
    for (; i + 16 <= n - edge; i += 16)
        vstore16(wx.x * column16(rows, i, wy) +
                     wx.y * (column16(rows, i - channels, wy) + column16(rows, i + channels, wy)) +
                     wx.z * (column16(rows, i - 2 * channels, wy) +
                             column16(rows, i + 2 * channels, wy)),
                 0, out + i);
    for (; i < n; ++i)
        out[i] = evened(rows, i, wy, wx, nx, channels);
#else
    FOR_X(i, n)
        out[i] = evened(rows, i, wy, wx, nx, channels);
#endif
}

inline float high_pass(const float value, const float low)
{
    const float difference = value - low;
    return fabs(difference) > ROUNDING * fabs(low) ? difference : 0.0f;
}

__kernel void local_energy(__global float *restrict out, __global const float *restrict picture,
                           __global const float *restrict low, const int ny, const int nx,
                           const int channels)
{
    const int y = get_global_id(1);
    picture += row_start(0, y, ny, nx * channels);
    low += row_start(0, y, ny, nx * channels);
    out += row_start(0, y, ny, nx);
    FOR_X(x, nx) {
#ifdef LUMA
        const int i = 3 * x;
        const float luma = 0.2126f * high_pass(picture[i], low[i]) +
                           0.7152f * high_pass(picture[i + 1], low[i + 1]) +
                           0.0722f * high_pass(picture[i + 2], low[i + 2]);
        out[x] = luma * luma;
#else
        float sum = 0.0f;
        for (int i = x * channels; i < (x + 1) * channels; ++i) {
            const float d = high_pass(picture[i], low[i]);
            sum += d * d;
        }
        out[x] = sum;
#endif
    }
}
