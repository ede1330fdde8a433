/* LANES floats at a time, at any address: vectors for the registers of a CPU.
 *
 * Vectors in packed structures replace vloadn and vstoren, which PoCL does not inline.
 * -DLANES=4 | 8 | 16; included only.
 */
#ifndef CLPLEN_VECTORS
#define CLPLEN_VECTORS
#include "stored.cl"

typedef JOIN(float, LANES) vec;
typedef JOIN(int, LANES) ivec;
typedef struct __attribute__((packed)) { vec v; } loose_vec;

#if LANES == 4
#define LANE ((ivec)(0, 1, 2, 3))
#elif LANES == 8
#define LANE ((ivec)(0, 1, 2, 3, 4, 5, 6, 7))
#else
#define LANE ((ivec)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15))
#endif

/* PoCL calls min, max and clamp as functions and saves all vectors around them. */
#define LESS(a, b) ((a) < (b) ? (a) : (b))
#define BOUND(a, low, high) ((a) < (low) ? (low) : (a) > (high) ? (high) : (a))

inline vec load(__global const float *from)
{
    return ((__global const loose_vec *)from)->v;
}

inline vec load_own(const float *from)
{
    return ((const loose_vec *)from)->v;
}

inline vec load_local(__local const float *from)
{
    return ((__local const loose_vec *)from)->v;
}

inline void store(__global float *to, const vec value)
{
    ((__global loose_vec *)to)->v = value;
}

inline void store_local(__local float *to, const vec value)
{
    ((__local loose_vec *)to)->v = value;
}

inline void store_own(float *to, const vec value)
{
    ((loose_vec *)to)->v = value;
}

/* The first n of LANES floats, the others 0. */
inline vec load_some(__global const float *from, const int n)
{
    union { vec v; float s[LANES]; } some;
    some.v = (vec)(0.0f);
    for (int x = 0; x < LANES && x < n; ++x)
        some.s[x] = from[x];
    return some.v;
}

/* LANES values at `at` of `size`, 0 beyond the ends. */
inline vec load_within(__global const float *from, const long at, const long size)
{
    if (at >= 0 && at + LANES <= size)
        return load(from + at);
    union { vec v; float s[LANES]; } some;
    for (int x = 0; x < LANES; ++x)
        some.s[x] = at + x >= 0 && at + x < size ? from[at + x] : 0.0f;
    return some.v;
}

inline void store_some(__global float *to, const vec value, const int n)
{
    union { vec v; float s[LANES]; } some;
    some.v = value;
    for (int x = 0; x < LANES && x < n; ++x)
        to[x] = some.s[x];
}

inline vec magnitude(const vec value)
{
    return JOIN(as_float, LANES)(JOIN(as_int, LANES)(value) & (ivec)(0x7fffffff));
}

/* One of three channels of LANES pixels, whose samples are in three vectors. Each lane has the channel
 * in one of the three vectors; the lanes are then sorted. */
#define THIRD(n) (LANE % (ivec)(3) == (ivec)((n) % 3))
#define MIXED(a, b, c, channel) \
    (THIRD(channel) ? (a) : THIRD((channel) + 3 - LANES % 3) ? (b) : (c))
#if LANES == 4
#define CHANNEL_0(a, b, c) (MIXED(a, b, c, 0).s0321)
#define CHANNEL_1(a, b, c) (MIXED(a, b, c, 1).s1032)
#define CHANNEL_2(a, b, c) (MIXED(a, b, c, 2).s2103)
#elif LANES == 8
#define CHANNEL_0(a, b, c) (MIXED(a, b, c, 0).s03614725)
#define CHANNEL_1(a, b, c) (MIXED(a, b, c, 1).s14725036)
#define CHANNEL_2(a, b, c) (MIXED(a, b, c, 2).s25036147)
#else
#define CHANNEL_0(a, b, c) (MIXED(a, b, c, 0).s0369cf258be147ad)
#define CHANNEL_1(a, b, c) (MIXED(a, b, c, 1).s147ad0369cf258be)
#define CHANNEL_2(a, b, c) (MIXED(a, b, c, 2).s258be147ad0369cf)
#endif
#endif
