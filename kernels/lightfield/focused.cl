/* Positions of a point under the lenslets of a focused plenoptic camera, and sampling there.
 *
 *   r_k(Y) = s_k + ratio (s_k - Y),    s_k = the centre of sub-image k = origin + i first + j second
 *
 * Y is the point's chief ray on the sensor, all in pixels, vectors as (y, x). Places
 * come as tables, an integer and a fraction in [0, 1), so that differences of them are exact; only
 * the search for lenslets uses the lattice in float32.
 *
 * -DCHANNELS=n   of the raw image, interleaved; default 1
 * -DLINEAR       linear interpolation, else cubic convolution (Keys 1981, eq. 15, a = -1/2)
 */
#include "common.cl"

#ifndef CHANNELS
#define CHANNELS 1
#endif

/* Weights of the pixels at -1, 0, 1, 2 for a position t in [0, 1]. */
inline void set_weights(float *w, const float t)
{
#ifdef LINEAR
    w[0] = 0;
    w[1] = 1 - t;
    w[2] = t;
    w[3] = 0;
#else
    w[0] = ((1.0f - 0.5f * t) * t - 0.5f) * t;
    w[1] = (1.5f * t - 2.5f) * t * t + 1.0f;
    w[2] = ((2.0f - 1.5f * t) * t + 0.5f) * t;
    w[3] = (0.5f * t - 0.5f) * t * t;
#endif
}

/* The derivative by t of the cubic weights. */
inline float4 tap_slopes(const float t)
{
    return (float4)((2.0f - 1.5f * t) * t - 0.5f, (4.5f * t - 5.0f) * t,
                    (4.0f - 4.5f * t) * t + 0.5f, (1.5f * t - 1.0f) * t);
}

/* Adds weight raw(at + part) to each channel's sum; pixels at the edge are repeated. */
inline void add_sample(float *sum, const float weight, __global const float *restrict raw,
                       const int2 at, const float2 part, const int ny, const int nx)
{
    const int cy = (int)part.s0 - (part.s0 < 0), cx = (int)part.s1 - (part.s1 < 0);
    const int y = at.s0 + cy - 1, x = at.s1 + cx - 1;
    float wy[4], wx[4];
    set_weights(wy, part.s0 - cy);
    set_weights(wx, part.s1 - cx);
    const bool inside = y >= 0 && y + 3 < ny && x >= 0 && x + 3 < nx;
    for (int a = 0; a < 4; ++a) {
        const int i = inside ? y + a : clamp(y + a, 0, ny - 1);
        __global const float *line = raw + (size_t)i * nx * CHANNELS;
        const float w = weight * wy[a];
        if (inside) {
            line += x * CHANNELS;
            for (int c = 0; c < CHANNELS; ++c)
                sum[c] += w * (wx[0] * line[c] + wx[1] * line[CHANNELS + c] +
                               wx[2] * line[2 * CHANNELS + c] + wx[3] * line[3 * CHANNELS + c]);
        } else {
            for (int b = 0; b < 4; ++b)
                for (int c = 0; c < CHANNELS; ++c)
                    sum[c] += w * wx[b] * line[clamp(x + b, 0, nx - 1) * CHANNELS + c];
        }
    }
}

/* True if a position lies between the centres of the sensor's outermost pixels. */
inline bool is_recorded(const int2 at, const float2 part, const int ny, const int nx)
{
    const float2 place = convert_float2(at) + part;
    return place.s0 >= 0 && place.s1 >= 0 && place.s0 <= ny - 1 && place.s1 <= nx - 1;
}

inline float cross2(const float2 a, const float2 b)
{
    return a.s0 * b.s1 - a.s1 * b.s0;
}

/* Indices (i, j) of the lattice point nearest to q, which counts from point (0, 0); first and
 * second are as short as vectors of the lattice can be. */
inline int2 nearest_lens(const float2 q, const float2 first, const float2 second)
{
    const float area = cross2(first, second);
    const float i = floor(cross2(q, second) / area), j = floor(cross2(first, q) / area);
    int2 best = (int2)(0, 0);
    float least = INFINITY;
    for (int a = 0; a < 2; ++a)
        for (int b = 0; b < 2; ++b) {
            const float2 way = q - (i + a) * first - (j + b) * second;
            const float square = way.s0 * way.s0 + way.s1 * way.s1;
            if (square < least) {
                least = square;
                best = (int2)((int)i + a, (int)j + b);
            }
        }
    return best;
}

/* The pixel value, mean over the channels. */
inline float grey(__global const float *restrict raw, const int y, const int x, const int nx)
{
    __global const float *pixel = raw + ((size_t)y * nx + x) * CHANNELS;
    float sum = pixel[0];
    for (int c = 1; c < CHANNELS; ++c)
        sum += pixel[c];
    return sum / CHANNELS;
}
