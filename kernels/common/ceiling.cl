/* The most multiplications and additions a second that a device does on data in its nearest cache.
 *
 *   s_j = s_j m + x,  `rounds` times,  0 <= j < CHAINS,     out[i] = sum_j s_j
 *
 * One item keeps CHAINS sums of LANES floats in registers, as many as hide the latency of one
 * multiply-add; 2 CHAINS LANES operations a round. x changes from round to round (it is read from
 * `few`, a power of two of floats that stay in the cache), so that no round can be left out. Of
 * vectors, out is the sum of the first two lanes.
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
