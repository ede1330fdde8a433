/* exp(2 pi i r) of a phase in turns by two polynomials: the library's sincos, which also serves
 * arguments of 1e30, is several times slower where a compiler does not vectorise it (PoCL).
 *
 *   r = n/2 + f,  n = rint(2 r),  abs(f) <= 1/4;   exp(2 pi i r) = (-1)^n (cos 2 pi f + i sin 2 pi f)
 *
 * Minimax in abs(f) <= 1/4: f P4(f^2) with 3.4e-9 for the sine, 1 + f^2 Q4(f^2) with 2.5e-10 for the
 * cosine; rounding adds up to 1.5e-7. abs(r) < 2^22, so that r keeps a fraction.
 *
 * -DDOUBLE  the library's sincos
 */
#ifndef CLPLEN_TURNS
#define CLPLEN_TURNS

#include "common.cl"

inline cplx cis_polynomial(real r)
{
#ifdef DOUBLE
    return cis_turns(r);
#else
    const float n = rint(2 * r);
    const float f = r - n / 2;
    const float u = f * f;
    const float sign = 1 - 2 * ((int)n & 1);
    const float s = 6.28318501f + u * (-41.3416557f + u * (81.6010056f + u * (-76.5497818f
        + u * 39.536705f)));
    const float c = u * (-19.7392082f + u * (64.9393539f + u * (-85.4538269f + u * (60.1482048f
        + u * -25.0067959f))));
    return (cplx)(sign + sign * c, sign * f * s);
#endif
}

#endif
