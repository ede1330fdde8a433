/* Maximum rate of multiplications and additions of a device on data in its nearest cache.
 *
 *   s_j = s_j m + x,  `rounds` times,  0 <= j < CHAINS,     out[i] = sum_j s_j
 *
 * An item has CHAINS sums of LANES floats in registers, enough to hide the latency of a multiply-add,
 * with 2 CHAINS LANES operations per round. x is read from `few`, a power of two of floats in the
 * cache, and changes from round to round, so that the compiler cannot omit a round. For vectors, out
 * is the sum of the first two lanes.
 *
 * -DLANES=1 | 4 | 8 | 16, -DCHAINS=n
 * Mapping: axis 0 = items.
 */
#define JOIN_(a, b) a##b
#define JOIN(a, b) JOIN_(a, b)
#if LANES == 1
typedef float vec;
#else
typedef JOIN(float, LANES) vec;
#endif

__kernel void multiply_add(__global float *restrict out, __global const float *restrict few,
                           const int mask, const int rounds, const float m)
{
    const int i = get_global_id(0);
    vec s[CHAINS];
#pragma unroll
    for (int j = 0; j < CHAINS; ++j)
        s[j] = (vec)(few[(i + j) & mask]);
    for (int r = 0; r < rounds; ++r) {
        const vec x = (vec)(few[(i + r) & mask]);
#pragma unroll
        for (int j = 0; j < CHAINS; ++j)
            s[j] = s[j] * (vec)(m) + x;
    }
    vec sum = s[0];
#pragma unroll
    for (int j = 1; j < CHAINS; ++j)
        sum += s[j];
#if LANES == 1
    out[i] = sum;
#else
    out[i] = sum.s0 + sum.s1;
#endif
}
