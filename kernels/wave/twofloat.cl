/* Arithmetic with unevaluated sums of two float32 (high, low): about 48 bits.
 *
 *   sum   Knuth 1969 (TAOCP 2, 4.2.2, theorem B): a + b = high + low exactly
 *   rest  Dekker 1971 with a fused multiply-add: a * b = p + rest exactly, p the rounded product
 *
 * For s = a + b and z/lam = l, all as pairs, s at most 1:
 *
 *   quotient  q = s/(1 + sqrt(1 - s)) as a pair
 *   phase     -(z/lam) q in turns, abs(phase) <= 1
 *   residual  -(z/lam) q^2/2 in turns likewise: the phase beside the tables of -(z/lam) s/2
 *
 * TWO_FLOAT defines them for float and, with -DLANES, for sixteen floats. Contraction is disabled,
 * since fused operations would destroy the low parts.
 */
#ifndef CLPLEN_TWOFLOAT
#define CLPLEN_TWOFLOAT

#pragma OPENCL FP_CONTRACT OFF

#define TWO_FLOAT(real, sum, rest, quotient, phase, residual)                                      \
    inline real sum(const real a, const real b, real *low)                                         \
    {                                                                                              \
        const real high = a + b;                                                                   \
        const real other = high - a;                                                               \
        *low = (a - (high - other)) + (b - other);                                                 \
        return high;                                                                               \
    }                                                                                              \
    inline real rest(const real a, const real b, const real product)                               \
    {                                                                                              \
        return fma(a, b, -product);                                                                \
    }                                                                                              \
    inline real quotient(const real ah, const real al, const real bh, const real bl, real *low)    \
    {                                                                                              \
        real sl, cl, dl;                                                                           \
        const real near = sum(ah, bh, &sl);                                                        \
        const real s = sum(near, sl + (al + bl), &sl);                                             \
        const real about = sum((real)1, -s, &cl);                                                  \
        real left = sum(about, cl - sl, &cl);                                                      \
        left = left > 0 ? left : 0;                                                                \
        /* the root of left: one Newton step from that of float32 */                               \
        const real root = sqrt(left);                                                              \
        const real square = root * root;                                                           \
        const real miss = ((left - square) - rest(root, root, square)) + cl;                       \
        const real d = sum((real)1, root, &dl);                                                    \
        dl += root > 0 ? miss / (2 * root) : 0;                                                    \
        const real q = s / d; /* one correction of the quotient of float32 */                      \
        const real back = q * d;                                                                   \
        *low = ((((s - back) - rest(q, d, back)) + sl) - q * dl) / d;                              \
        return q;                                                                                  \
    }                                                                                              \
    inline real phase(const real ah, const real al, const real bh, const real bl, const real lh,   \
                      const real ll)                                                               \
    {                                                                                              \
        real ql;                                                                                   \
        const real q = quotient(ah, al, bh, bl, &ql);                                              \
        const real turns = lh * q;                                                                 \
        return (rint(turns) - turns) - (rest(lh, q, turns) + (lh * ql + ll * q));                  \
    }                                                                                              \
    inline real residual(const real ah, const real al, const real bh, const real bl,               \
                         const real lh, const real ll)                                             \
    {                                                                                              \
        real ql;                                                                                   \
        const real q = quotient(ah, al, bh, bl, &ql);                                              \
        const real half_square = q * q / 2;                                                        \
        const real low = rest(q, q / 2, half_square) + q * ql;                                     \
        const real turns = lh * half_square;                                                       \
        return (rint(turns) - turns)                                                               \
               - (rest(lh, half_square, turns) + (lh * low + ll * half_square));                   \
    }

TWO_FLOAT(float, two_sum, two_rest, two_quotient, two_phase, two_residual)
#ifdef LANES
TWO_FLOAT(float16, two_sum16, two_rest16, two_quotient16, two_phase16, two_residual16)
#endif

#endif
