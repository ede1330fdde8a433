/* Philox4x32-10, a counter-based random generator (Salmon et al. 2011, section 3.3).
 *
 * Included by other files. Whole numbers only: the same words on every device, as
 * clplen/wave/coherence/spatial_models.py makes on the host.
 */
#ifndef CLPLEN_PHILOX
#define CLPLEN_PHILOX

inline uint4 philox(uint4 counter, uint2 key)
{
    for (int i = 0; i < 10; ++i) {
        const uint high0 = mul_hi(0xD2511F53u, counter.x), low0 = 0xD2511F53u * counter.x;
        const uint high1 = mul_hi(0xCD9E8D57u, counter.z), low1 = 0xCD9E8D57u * counter.z;
        counter = (uint4)(high1 ^ counter.y ^ key.x, low1, high0 ^ counter.w ^ key.y, low0);
        key += (uint2)(0x9E3779B9u, 0xBB67AE85u);
    }
    return counter;
}

#endif
