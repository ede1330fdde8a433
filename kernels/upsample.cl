/* Refocus on a grid N times finer: the samples of all views, each at its own place.
 *
 *   out[Y, X] = sum_kyx W L[view[k], y, x] / sum_kyx W,   ty, tx = distances in pixels of the views
 *   W = w[k] (tent(N ty) tent(N tx) + base tent(ty) tent(tx)),   tent(t) = max(1 - |t|, 0)
 *
 * Row Y lies at ((Y + 1/2)/N - 1/2) of a view, moved by the shift of view k: tables hold, for each
 * view and each of the N phases Y mod N, the upper of the two nearest pixels and, made in float64,
 * the tents of both (tent(N t) of the two, then tent(t) of the two). `base` fills what no sample
 * comes near. Samples outside a view do not count.
 *
 * Mapping: FOR_X over (X, c); axis 1 = Y. -DROWS: see common.cl.
 * -DSAMPLE=uchar | ushort | float: what the light field stores.
 */
#include "common.cl"

__kernel void interleave(__global float *restrict out, __global const SAMPLE *restrict L,
                         __global const int *restrict view, __global const float *restrict weight,
                         __global const int *restrict down, __global const float4 *restrict below,
                         __global const int *restrict right, __global const float4 *restrict beside,
                         const int count, const int N, const float base, const int ny, const int nx,
                         const int channels)
{
    const int Y = get_global_id(1);
    const size_t to = row_start(0, Y, N * ny, N * nx * channels);
    FOR_X(s, N * nx * channels) {
        const int X = s / channels, c = s % channels;
        float sum = 0.0f, used = 0.0f;
        for (int k = 0; k < count; ++k) {
            const int i = Y / N + down[k * N + Y % N], j = X / N + right[k * N + X % N];
            const float4 ty = below[k * N + Y % N], tx = beside[k * N + X % N];
            __global const SAMPLE *from = L + row_start(view[k], 0, ny, nx) * channels;
            for (int a = 0; a < 2; ++a)
                for (int b = 0; b < 2; ++b) {
                    const float w = weight[k] * ((a ? ty.y : ty.x) * (b ? tx.y : tx.x) +
                                                 base * (a ? ty.w : ty.z) * (b ? tx.w : tx.z));
                    const int y = i + a, x = j + b;
                    if (w > 0.0f && y >= 0 && y < ny && x >= 0 && x < nx) {
                        sum += w * (float)from[((size_t)y * nx + x) * channels + c];
                        used += w;
                    }
                }
        }
        out[to + s] = used > 0.0f ? sum / used : 0.0f;
    }
}
