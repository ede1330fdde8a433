/* Number of NaN and infinite reals in each segment of an array.
 *
 *   bad[i] = #{j in [i length, (i + 1) length) : not isfinite(a[j])}
 *
 * Mapping: one item per segment with -DROWS, else a group of GROUP items with interleaved reads.
 * -DDOUBLE: float64, -DHALF: float16. A complex sample is two reals.
 */
#include "common.cl"

/* A sample is NaN or infinite if all bits of its exponent are set. Compilers vectorise this integer
 * test, but not isfinite(). */
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

#ifdef ROWS
#define GROUP 1
#else
#define GROUP 64
#endif

__kernel void count_bad(__global int *restrict bad, __global const real *restrict a,
                        const long size, const int length)
{
    const int stretch = get_global_id(0) / GROUP;
    const int first = get_global_id(0) % GROUP;
    const long start = (long)stretch * length;
    const int n = (int)min((long)length, size - start);
    __global const bits *from = (__global const bits *)a + start;
    int count = 0;
    for (int j = first; j < n; j += GROUP)
        count += (from[j] & EXPONENT) == EXPONENT;
#ifdef ROWS
    bad[stretch] = count;
#else
    __local int counts[GROUP];
    counts[first] = count;
    for (int step = GROUP / 2; step > 0; step /= 2) {
        barrier(CLK_LOCAL_MEM_FENCE);
        if (first < step)
            counts[first] += counts[first + step];
    }
    if (first == 0)
        bad[stretch] = counts[0];
#endif
}
