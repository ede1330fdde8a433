/* Sixteen floats, or sixteen complex floats, at a time, at any address.
 *
 * Vectors in packed structures replace vloadn and vstoren, which PoCL does not inline. Real and
 * imaginary parts are two vectors: `deal` separates thirty-two interleaved floats, `merge` interleaves
 * them. Included only.
 */
#ifndef CLPLEN_LANES
#define CLPLEN_LANES

typedef struct __attribute__((packed)) { float16 v; } loose16;

inline float16 load16(__global const float *from)
{
    return ((__global const loose16 *)from)->v;
}

inline float16 load16_local(__local const float *from)
{
    return ((__local const loose16 *)from)->v;
}

inline void store16(__global float *to, const float16 value)
{
    ((__global loose16 *)to)->v = value;
}

inline void store16_local(__local float *to, const float16 value)
{
    ((__local loose16 *)to)->v = value;
}

inline void deal(__global const float *from, float16 *re, float16 *im)
{
    const float16 a = load16(from), b = load16(from + 16);
    *re = (float16)(a.even, b.even);
    *im = (float16)(a.odd, b.odd);
}

inline void merge(__global float *to, const float16 re, const float16 im)
{
    float16 a, b;
    a.even = re.lo;
    a.odd = im.lo;
    b.even = re.hi;
    b.odd = im.hi;
    store16(to, a);
    store16(to + 16, b);
}

/* to = from times (tr, ti); both may be the same memory. */
inline void times16(__global float *to, __global const float *from, const float16 tr,
                    const float16 ti)
{
    float16 re, im;
    deal(from, &re, &im);
    merge(to, re * tr - im * ti, re * ti + im * tr);
}

/* exp(2 pi i r) as in cis_turns of common.cl, abs(r) < 2^21. Adding 1.5 2^23 rounds 2 r to an integer
 * n; the last bit of the sum's mantissa is the last bit of n and becomes the sign. */
inline void cis16(const float16 r, float16 *re, float16 *im)
{
    const float16 sum = 2 * r + 12582912.0f;
    const int16 sign = as_int16(sum) << 31;
    const float16 f = r - (sum - 12582912.0f) * 0.5f;
    const float16 u = f * f;
    const float16 s = f * (6.28318501f + u * (-41.3416557f + u * (81.6010056f + u * (-76.5497818f
        + u * 39.536705f))));
    const float16 c = 1 + u * (-19.7392082f + u * (64.9393539f + u * (-85.4538269f
        + u * (60.1482048f + u * -25.0067959f))));
    *re = as_float16(as_int16(c) ^ sign);
    *im = as_float16(as_int16(s) ^ sign);
}

#endif
