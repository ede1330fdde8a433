/* Sixteen floats at a time, at any address.
 *
 * Vectors in packed structures take the place of vloadn and vstoren, which PoCL does not inline.
 * Included only.
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

#endif
