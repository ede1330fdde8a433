/* Stretches of four neighbouring rows of a view, combined along y, sixteen samples at a time.
 *
 * -DSAMPLE=uchar | ushort | half | float, -DLANES=16, -DCHANNELS=1 | 3; included only.
 */
#ifndef CLPLEN_STRIPS
#define CLPLEN_STRIPS
#include "lanes.cl"
#include "stored.cl"

#define LANE ((int16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15))

/* 16 samples from CHANNELS, 2 CHANNELS and 3 CHANNELS samples further right on. */
#if CHANNELS == 1
#define RIGHT_1(a, b) (float16)(a.s1234, a.s5678, a.s9abc, a.sde, a.sf, b.s0)
#define RIGHT_2(a, b) (float16)(a.s2345, a.s6789, a.sabcd, a.sef, b.s01)
#define RIGHT_3(a, b) (float16)(a.s3456, a.s789a, a.sbcde, a.sf, b.s012)
#else
#define RIGHT_1(a, b) (float16)(a.s3456, a.s789a, a.sbcde, a.sf, b.s012)
#define RIGHT_2(a, b) (float16)(a.s6789, a.sabcd, a.sef, b.s0123, b.s45)
#define RIGHT_3(a, b) (float16)(a.s9abc, a.sdef, b.s0, b.s1234, b.s5678)
#endif

inline float16 magnitude(const float16 value)
{
    return as_float16(as_int16(value) & (int16)(0x7fffffff));
}

/* Four rows of a view, and what lies before and after them. */
typedef struct {
    __global const SAMPLE *row[4];
    float4 taps;
    int samples; /* of a row */
    int inner;   /* whether rows of the same view lie before and after each of the four */
} strip;

/* 16 samples from `first` on, which lie inside the rows or inside those beside them. */
inline float16 strip_vector(const strip s, const int first)
{
    return (float16)(s.taps.x) * stored_vec(s.row[0] + first)
           + (float16)(s.taps.y) * stored_vec(s.row[1] + first)
           + (float16)(s.taps.z) * stored_vec(s.row[2] + first)
           + (float16)(s.taps.w) * stored_vec(s.row[3] + first);
}

inline float strip_sample(const strip s, const int i)
{
    return s.taps.x * stored(s.row[0], i) + s.taps.y * stored(s.row[1], i)
           + s.taps.z * stored(s.row[2], i) + s.taps.w * stored(s.row[3], i);
}

/* 16 samples from `first` on, the outermost pixel repeated beyond the edges. */
inline float16 strip_edge(const strip s, const int first)
{
    const int beside = first < 0 ? first + 16 <= s.samples : first <= s.samples;
    if (s.inner && beside && first >= -s.samples && first + 16 <= 2 * s.samples) {
        const int16 place = LANE + (int16)(first);
        const float16 value = strip_vector(s, first);
        const int edge = first < 0 ? 0 : s.samples - CHANNELS;
        float16 outermost = (float16)(strip_sample(s, edge));
#if CHANNELS == 3
        const int16 channel = (place + (int16)(3 << 20)) % (int16)(3);
        const float16 second = (float16)(strip_sample(s, edge + 1));
        const float16 third = (float16)(strip_sample(s, edge + 2));
        outermost = channel == (int16)(1) ? second : outermost;
        outermost = channel == (int16)(2) ? third : outermost;
#endif
        return place < (int16)(0) | place >= (int16)(s.samples) ? outermost : value;
    }
    union { float16 v; float s[16]; } sum;
    for (int i = 0; i < 16; ++i) {
        const int channel = (first + i + (CHANNELS << 20)) % CHANNELS;
        const int from = first + i - channel;
        sum.s[i] = strip_sample(s, clamp(from, 0, s.samples - CHANNELS) + channel);
    }
    return sum.v;
}

/* The four rows of a view that pixel row `row` + 1 lies between, and their taps. */
inline strip strip_of(__global const SAMPLE *view, const int row, const float4 taps, const int ny,
                      const int nx)
{
    strip s;
    for (int t = 0; t < 4; ++t)
        s.row[t] = view + (size_t)clamp(row + t, 0, ny - 1) * nx * CHANNELS;
    s.taps = taps;
    s.samples = nx * CHANNELS;
    s.inner = row >= 1 && row + 4 < ny;
    return s;
}

inline float16 strip_load(const strip s, const int first)
{
    return first >= 0 && first + 16 <= s.samples ? strip_vector(s, first) : strip_edge(s, first);
}

/* Interpolated along x between two neighbouring vectors. */
inline float16 across_taps(const float4 taps, const float16 a, const float16 b)
{
    return (float16)(taps.x) * a + (float16)(taps.y) * RIGHT_1(a, b)
           + (float16)(taps.z) * RIGHT_2(a, b) + (float16)(taps.w) * RIGHT_3(a, b);
}

/* One channel of 16 pixels of which three vectors hold the three channels, sample by sample. */
#if CHANNELS == 3
#define CHANNEL_0(a, b, c) (float16)(a.s0369, a.scf, b.s258b, b.se, c.s147a, c.sd)
#define CHANNEL_1(a, b, c) (float16)(a.s147a, a.sd, b.s0369, b.scf, c.s258b, c.se)
#define CHANNEL_2(a, b, c) (float16)(a.s258b, a.se, b.s147a, b.sd, c.s0369, c.scf)
#endif
#endif
