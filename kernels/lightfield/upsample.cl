/* Refocus on a grid N times finer, with the samples of all views at their positions.
 *
 *   out[Y, X] = sum_kyx W L[view[k], y, x] / sum_kyx W,   ty, tx = distances in pixels of the views
 *   W = w[k] (tent(N ty) tent(N tx) + base tent(ty) tent(tx)),   tent(t) = max(1 - |t|, 0)
 *
 * Row Y lies at ((Y + 1/2)/N - 1/2) of a view, moved by the shift of view k: tables hold, for each
 * view and each of the N phases Y mod N, the upper of the two nearest pixels and, made in float64,
 * the tents of both (tent(N t) of the two, then tent(t) of the two). `base` fills gaps between
 * samples. Samples outside a view are ignored.
 *
 * One item = one fine sample (X, c) of row Y, or with -DROWS the row, phase by phase in blocks of 16
 * samples of the views; axis 1 = Y. -DSAMPLE=uchar | ushort | half | float: storage type of the light field.
 */
#include "common.cl"
#include "stored.cl"

#ifdef ROWS
#define BLOCK 16
#else
#define BLOCK 1
#endif

/* BLOCK samples of the views' own grid from s0 on (n of them in the picture), at one phase of Y and
 * of X, into every N-th pixel of the fine row `out`. */
inline void block(__global float *out, __global const SAMPLE *L, __global const int *view,
                  __global const float *weight, __global const int *down,
                  __global const float4 *below, __global const int *right,
                  __global const float4 *beside, const int count, const int N, const float base,
                  const int Y, const int phase, const int s0, const int n, const int ny,
                  const int nx, const int channels)
{
    const int samples = nx * channels;
    float sum[BLOCK], used[BLOCK];
    for (int i = 0; i < BLOCK; ++i)
        sum[i] = used[i] = 0.0f;
    for (int k = 0; k < count; ++k) {
        const int line = k * N + Y % N, place = k * N + phase;
        const float4 ty = below[line], tx = beside[place];
        const int top = Y / N + down[line], left = s0 + right[place] * channels;
        for (int a = max(0, -top); a < min(2, ny - top); ++a) {
            __global const SAMPLE *row = L + row_start(view[k], top + a, ny, samples);
            for (int b = 0; b < 2; ++b) {
                const float w = weight[k] * ((a ? ty.y : ty.x) * (b ? tx.y : tx.x) +
                                             base * (a ? ty.w : ty.z) * (b ? tx.w : tx.z));
                const int s = left + b * channels;
                const int begin = clamp(-s, 0, n), end = clamp(samples - s, 0, n);
                if (end - begin == BLOCK)
                    for (int i = 0; i < BLOCK; ++i) {
                        sum[i] += w * stored(row, s + i);
                        used[i] += w;
                    }
                else
                    for (int i = begin; i < end; ++i) {
                        sum[i] += w * stored(row, s + i);
                        used[i] += w;
                    }
            }
        }
    }
    for (int i = 0; i < n; ++i) {
        const int x = (s0 + i) / channels * N + phase, c = (s0 + i) % channels;
        out[x * channels + c] = used[i] > 0.0f ? sum[i] / used[i] : 0.0f;
    }
}

__kernel void interleave(__global float *restrict out, __global const SAMPLE *restrict L,
                         __global const int *restrict view, __global const float *restrict weight,
                         __global const int *restrict down, __global const float4 *restrict below,
                         __global const int *restrict right, __global const float4 *restrict beside,
                         const int count, const int N, const float base, const int ny, const int nx,
                         const int channels)
{
    const int Y = get_global_id(1), samples = nx * channels;
    out += row_start(0, Y, N * ny, N * samples);
#ifdef ROWS
    for (int phase = 0; phase < N; ++phase)
        for (int s0 = 0; s0 < samples; s0 += BLOCK)
            block(out, L, view, weight, down, below, right, beside, count, N, base, Y, phase, s0,
                  min(BLOCK, samples - s0), ny, nx, channels);
#else
    const int s = get_global_id(0);
    const int X = s / channels;
    if (s < N * samples)
        block(out, L, view, weight, down, below, right, beside, count, N, base, Y, X % N,
              X / N * channels + s % channels, 1, ny, nx, channels);
#endif
}
