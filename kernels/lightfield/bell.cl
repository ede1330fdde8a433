/* A Gaussian-like weight of finite support.
 *
 *   bell(q) = max(1 - q/8, 0)^8, close to exp(-q), and 0 beyond 8
 *
 * -DLANES=4 | 8 | 16: also bells, for vectors (vectors.cl). Included only.
 */
#ifndef CLPLEN_BELL
#define CLPLEN_BELL
#ifdef LANES
#include "vectors.cl"
#endif

inline float bell(const float q)
{
    const float r = fmax(1 - q * 0.125f, 0.0f);
    const float r2 = r * r;
    const float r4 = r2 * r2;
    return r4 * r4;
}

#ifdef LANES
inline vec bells(const vec q)
{
    const vec rest = (vec)(1.0f) - q * (vec)(0.125f);
    const vec r = rest > (vec)(0.0f) ? rest : (vec)(0.0f);
    const vec r2 = r * r;
    const vec r4 = r2 * r2;
    return r4 * r4;
}
#endif

#endif
