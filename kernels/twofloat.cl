/* Arithmetic with unevaluated sums of two float32 (high, low): about 48 bits.
 *
 *   two_sum   Knuth 1969 (TAOCP 2, 4.2.2, theorem B): a + b = high + low exactly
 *   two_prod  Dekker 1971 with a fused multiply-add: a * b = high + low exactly
 *
 * Contraction is switched off here: a compiler that fuses these lines destroys the low parts.
 */
#ifndef CLPLEN_TWOFLOAT
#define CLPLEN_TWOFLOAT

#pragma OPENCL FP_CONTRACT OFF

inline float2 two_sum(float a, float b)
{
    const float high = a + b;
    const float other = high - a;
    return (float2)(high, (a - (high - other)) + (b - other));
}

inline float2 two_prod(float a, float b)
{
    const float high = a * b;
    return (float2)(high, fma(a, b, -high));
}

/* -(z/lam) s/(1 + sqrt(1 - s)) in turns, reduced to |t| <= 1/2; s = ax + ay, all as pairs. */
inline float two_phase(float2 ax, float2 ay, float2 zl)
{
    float2 s = two_sum(ax.x, ay.x);
    s.y += ax.y + ay.y;
    float2 left = two_sum(1.0f, -s.x);
    left.y -= s.y;
    /* c = sqrt(left): one Newton step from the float32 root */
    const float root = sqrt(left.x);
    const float2 square = two_prod(root, root);
    const float miss = ((left.x - square.x) - square.y) + left.y;
    const float tail = root > 0.0f ? miss / (2.0f * root) : 0.0f;
    float2 d = two_sum(1.0f, root);
    d.y += tail;
    /* q = s/d: one correction of the float32 quotient */
    const float q = s.x / d.x;
    const float2 back = two_prod(q, d.x);
    const float rest = (((s.x - back.x) - back.y) + s.y) - q * d.y;
    const float low = rest / d.x;
    const float2 turns = two_prod(zl.x, q);
    const float t = (turns.x - rint(turns.x)) + (turns.y + zl.x * low + zl.y * q);
    return -t;
}

#endif
