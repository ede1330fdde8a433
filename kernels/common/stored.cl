/* Stored samples of a light field, read as float.
 *
 * -DSAMPLE=uchar | ushort | half | float   type of the stored samples (half without cl_khr_fp16)
 * -DLANES=4 | 8 | 16                       samples of stored_vec, at any address
 * Included only.
 */
#ifndef CLPLEN_STORED
#define CLPLEN_STORED

#define JOIN_(a, b) a##b
#define JOIN(a, b) JOIN_(a, b)

#ifdef SAMPLE
#define STORED_uchar(from, i) ((float)(from)[i])
#define STORED_ushort(from, i) ((float)(from)[i])
#define STORED_half(from, i) vload_half(i, from)
#define STORED_float(from, i) ((from)[i])

/* Sample i from an address on. */
inline float stored(__global const SAMPLE *from, const size_t i)
{
    return JOIN(STORED_, SAMPLE)(from, i);
}

#if defined(LANES) && LANES > 1
/* Vectors in packed structures replace vloadn, which PoCL does not inline. */
typedef struct __attribute__((packed)) { JOIN(uchar, LANES) v; } loose_uchar;
typedef struct __attribute__((packed)) { JOIN(ushort, LANES) v; } loose_ushort;
typedef struct __attribute__((packed)) { JOIN(float, LANES) v; } loose_float;

#define LOOSE(type, from) \
    JOIN(convert_float, LANES)(((__global const JOIN(loose_, type) *)(from))->v)
#define STORED_VEC_uchar(from) LOOSE(uchar, from)
#define STORED_VEC_ushort(from) LOOSE(ushort, from)
#define STORED_VEC_half(from) JOIN(vload_half, LANES)(0, from)
#define STORED_VEC_float(from) (((__global const loose_float *)(from))->v)
#define stored_vec(from) JOIN(STORED_VEC_, SAMPLE)(from)
#endif
#endif

#endif
