/* How many reals of each stretch of an array are NaN or infinite.
 *
 *   bad[i] = #{j in [i length, (i + 1) length) : not isfinite(a[j])}
 *
 * Mapping: one item a stretch. -DDOUBLE: float64, -DHALF: float16. A complex sample is two reals.
 */
#include "common.cl"

/* A sample is NaN or infinite when every bit of its exponent is set: an integer test, which
 * compilers vectorise where they call isfinite(). */
#ifdef DOUBLE
typedef ulong bits;
#define EXPONENT 0x7ff0000000000000UL
#elif defined(HALF)
typedef ushort bits;
#define EXPONENT 0x7c00
#else
typedef uint bits;
#define EXPONENT 0x7f800000u
#endif

__kernel void count_bad(__global int *restrict bad, __global const real *restrict a,
                        const long size, const int length)
{
    const long start = (long)get_global_id(0) * length;
    if (start >= size)
        return;
    __global const bits *from = (__global const bits *)a + start;
    const int n = (int)min((long)length, size - start);
    int count = 0;
    for (int j = 0; j < n; ++j)
        count += (from[j] & EXPONENT) == EXPONENT;
    bad[get_global_id(0)] = count;
}
