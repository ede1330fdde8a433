/* Neighbouring rows of views combined along y by four taps each, and interpolated along x.
 *
 *   to[r, i] = sum_t taps[t] view[top + r + t, first + i],   0 <= r < STRIP_HEIGHT, 0 <= i < count
 *
 * i counts samples, channels fastest; beyond the edges the outermost pixel is repeated. Every row is
 * read and converted once for all r.
 *
 * -DSAMPLE=uchar | ushort | half | float, -DLANES=4 | 8 | 16, -DCHANNELS=1 | 3
 * STRIP_HEIGHT, STRIP_PITCH: rows, and floats between them in `to`. Included only.
 */
#ifndef CLPLEN_STRIPS
#define CLPLEN_STRIPS
#include "vectors.cl"

inline float strip_sample(__global const SAMPLE *const *row, const float4 taps, const int i)
{
    return taps.x * stored(row[0], i) + taps.y * stored(row[1], i) + taps.z * stored(row[2], i)
           + taps.w * stored(row[3], i);
}

/* The samples of a strip that lie inside the view, from begin to end. */
inline void strip_inside(float *to, __global const SAMPLE *const *row, const int first,
                         const int begin, const int end, const float4 taps)
{
    if (end - begin < LANES) {
        for (int r = 0; r < STRIP_HEIGHT; ++r)
            for (int i = begin; i < end; ++i)
                to[r * STRIP_PITCH + i] = strip_sample(row + r, taps, first + i);
        return;
    }
    const vec a = (vec)(taps.x), b = (vec)(taps.y), c = (vec)(taps.z), d = (vec)(taps.w);
    for (int j = begin; j < end; j += LANES) { /* the last vector over part of the one before */
        const int i = LESS(j, end - LANES);
        vec v[STRIP_HEIGHT + 3];
#pragma unroll
        for (int t = 0; t < STRIP_HEIGHT + 3; ++t)
            v[t] = stored_vec(row[t] + first + i);
#pragma unroll
        for (int r = 0; r < STRIP_HEIGHT; ++r)
            store_own(to + r * STRIP_PITCH + i,
                      a * v[r] + b * v[r + 1] + c * v[r + 2] + d * v[r + 3]);
    }
}

inline void strip(float *to, __global const SAMPLE *view, const int top, const int first,
                  const int count, const float4 taps, const int ny, const int nx)
{
    const int samples = nx * CHANNELS;
    const int begin = BOUND(-first, 0, count), end = BOUND(samples - first, begin, count);
    __global const SAMPLE *row[STRIP_HEIGHT + 3];
#pragma unroll
    for (int t = 0; t < STRIP_HEIGHT + 3; ++t)
        row[t] = view + (size_t)BOUND(top + t, 0, ny - 1) * samples;
    strip_inside(to, row, first, begin, end, taps);
    if (begin == 0 && end == count)
        return;
    for (int r = 0; r < STRIP_HEIGHT; ++r)
        for (int c = 0; c < CHANNELS; ++c) {
            const float left = strip_sample(row + r, taps, c);
            const float right = strip_sample(row + r, taps, samples - CHANNELS + c);
            for (int i = c; i < begin; i += CHANNELS)
                to[r * STRIP_PITCH + i] = left;
            for (int i = end + c; i < count; i += CHANNELS)
                to[r * STRIP_PITCH + i] = right;
        }
}

/* Interpolated along x: LANES samples of a strip, of which the first lies between the second pixel
 * from `from` on and the next. */
inline vec across_taps(const float4 taps, const float *from)
{
    return (vec)(taps.x) * load_own(from) + (vec)(taps.y) * load_own(from + CHANNELS)
           + (vec)(taps.z) * load_own(from + 2 * CHANNELS)
           + (vec)(taps.w) * load_own(from + 3 * CHANNELS);
}
#endif
