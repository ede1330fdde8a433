/* Light fields in the Fourier domain, one channel at a time, complex64.
 *
 *   take_views   out[k, y, x] = w[k] L[view[k], y, x, channel]
 *   keep_real    out[k, y, x, channel] = scale[k] Re in[k, y, x]
 *   turn_views   F[k, ky, kx] *= ty[k, ky] tx[k, kx]                views shifted by phase ramps
 *   transform_views
 *                out[b, i, n] = sum_j M[i, j] in[b, j, n]           a DFT over one axis of views
 *   ramp_sum     S[p, ky, kx] += sum_k ty[p, k, ky] tx[p, k, kx] F[k, ky, kx]
 *                (t = exp(2 pi i f s), a shift by s: Fourier shift theorem)
 *   oblique      R[p, ky, kx] = ty[p, ky] tx[p, kx] sum_ab gy[p, ky, a] gx[p, kx, b]
 *                               G[(i + a) mod Kv, (j + b) mod Ku, ky, kx],
 *                i = first_y[p, ky], j = first_x[p, kx]: the slice of Ng 2005, interpolated
 *
 * Mapping: FOR_X over x (n of transform_views); axis 1 = y (or i), axis 2 = k, b or p; ramp_sum and
 * oblique take one plane p an item.
 *
 * -DSAMPLE=uchar | ushort | half | float   storage type of the light field (take_views)
 * -DWIDTH=n                         oblique: taps along each axis of views
 * -DROWS                            see common.cl; transform_views in blocks of 256 samples
 */
#include "common.cl"
#include "stored.cl"

#ifdef ROWS
#define BLOCK 256
#define FOR_BLOCKS(x0, n) for (int x0 = 0; x0 < (n); x0 += BLOCK)
#else
#define BLOCK 1
#define FOR_BLOCKS(x0, n) for (int x0 = get_global_id(0); x0 < (n); x0 = (n))
#endif

inline float2 product(const float2 a, const float2 b)
{
    return (float2)(a.x * b.x - a.y * b.y, a.x * b.y + a.y * b.x);
}

#ifdef SAMPLE
__kernel void take_views(__global float2 *restrict out, __global const SAMPLE *restrict L,
                         __global const int *restrict view, __global const float *restrict weight,
                         const int ny, const int nx, const int channels, const int channel)
{
    const int y = get_global_id(1), k = get_global_id(2);
    const size_t to = row_start(k, y, ny, nx);
    const size_t from = row_start(view[k], y, ny, nx);
    FOR_X(x, nx)
        out[to + x] = (float2)(weight[k] * stored(L, (from + x) * channels + channel), 0.0f);
}
#endif

__kernel void keep_real(__global float *restrict out, __global const float2 *restrict in,
                        __global const float *restrict scale, const int ny, const int nx,
                        const int channels, const int channel)
{
    const int y = get_global_id(1), k = get_global_id(2);
    const size_t row = row_start(k, y, ny, nx);
    FOR_X(x, nx)
        out[(row + x) * channels + channel] = scale[k] * in[row + x].x;
}

__kernel void transform_views(__global float2 *restrict out, __global const float2 *restrict in,
                              __global const float2 *restrict M, const int rows,
                              const int columns, const int n)
{
    const int i = get_global_id(1), b = get_global_id(2);
    __global float2 *to = out + row_start(b, i, rows, n);
    FOR_BLOCKS(x0, n) {
        const int width = min(BLOCK, n - x0);
        float2 sum[BLOCK];
        for (int x = 0; x < BLOCK; ++x)
            sum[x] = (float2)(0.0f, 0.0f);
        for (int j = 0; j < columns; ++j) {
            const float2 m = M[i * columns + j];
            __global const float2 *from = in + row_start(b, j, columns, n) + x0;
            for (int x = 0; x < width; ++x)
                sum[x] += product(m, from[x]);
        }
        for (int x = 0; x < width; ++x)
            to[x0 + x] = sum[x];
    }
}

__kernel void turn_views(__global float2 *restrict F, __global const float2 *restrict ty,
                         __global const float2 *restrict tx, const int ny, const int nx)
{
    const int y = get_global_id(1), k = get_global_id(2);
    const size_t row = row_start(k, y, ny, nx);
    FOR_X(x, nx)
        F[row + x] = product(product(ty[k * ny + y], tx[k * nx + x]), F[row + x]);
}

__kernel void ramp_sum(__global float2 *restrict S, __global const float2 *restrict F,
                       __global const float2 *restrict ty, __global const float2 *restrict tx,
                       const int views, const int ny, const int nx)
{
    const int y = get_global_id(1), p = get_global_id(2);
    __global float2 *to = S + row_start(p, y, ny, nx);
    for (int k = 0; k < views; ++k) {
        const float2 a = ty[((size_t)p * views + k) * ny + y];
        __global const float2 *b = tx + ((size_t)p * views + k) * nx;
        __global const float2 *from = F + row_start(k, y, ny, nx);
        FOR_X(x, nx)
            to[x] += product(product(a, b[x]), from[x]);
    }
}

#ifdef WIDTH
__kernel void oblique(__global float2 *restrict R, __global const float2 *restrict G,
                      __global const int *restrict first_y, __global const float *restrict gy,
                      __global const float2 *restrict ty, __global const int *restrict first_x,
                      __global const float *restrict gx, __global const float2 *restrict tx,
                      const int Kv, const int Ku, const int ny, const int nx)
{
    const int y = get_global_id(1), p = get_global_id(2);
    __global float2 *to = R + row_start(p, y, ny, nx);
    const int row = p * ny + y;
    FOR_X(x, nx) {
        const int column = p * nx + x;
        float2 sum = (float2)(0.0f, 0.0f);
        for (int a = 0; a < WIDTH; ++a) {
            const int v = (first_y[row] + a) % Kv;
            float2 line = (float2)(0.0f, 0.0f);
            for (int b = 0; b < WIDTH; ++b) {
                const int u = (first_x[column] + b) % Ku;
                line += gx[column * WIDTH + b] * G[row_start(v * Ku + u, y, ny, nx) + x];
            }
            sum += gy[row * WIDTH + a] * line;
        }
        to[x] = product(product(ty[row], tx[column]), sum);
    }
}
#endif
