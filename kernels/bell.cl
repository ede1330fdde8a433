/* A weight that falls like a Gaussian and ends.
 *
 *   bell(q) = max(1 - q/8, 0)^8, close to exp(-q), and 0 beyond 8
 *
 * Included only.
 */
#ifndef CLPLEN_BELL
#define CLPLEN_BELL

inline float bell(const float q)
{
    const float r = fmax(1 - q * 0.125f, 0.0f);
    const float r2 = r * r;
    const float r4 = r2 * r2;
    return r4 * r4;
}

#endif
