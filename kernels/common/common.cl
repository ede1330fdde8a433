/* Types, loops and phase arithmetic shared by all kernels.
 *
 * -DDOUBLE   wave fields in float64 (requires cl_khr_fp64); float32 otherwise
 * -DROWS     a work-item processes a row (CPUs: the compiler vectorises the loop);
 *            otherwise a work-item processes a sample (GPUs)
 *
 * Mapping of every kernel written with FOR_X: axis 0 = x, axis 1 = y, axis 2 = batch.
 *
 * Functions are plain `inline`: Oclgrind 21.10 finds no kernel in files with `static inline` functions
 * that return structures.
 */
#ifndef CLPLEN_COMMON
#define CLPLEN_COMMON

#ifdef DOUBLE
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
typedef double real;
typedef double2 cplx;
typedef double2 real2;
#define TWO_PI (2 * M_PI)
#else
typedef float real;
typedef float2 cplx;
typedef float2 real2;
#define TWO_PI (2 * M_PI_F)
#endif

#ifdef ROWS
#define FOR_X(x, nx) for (int x = 0; x < (nx); ++x)
#define FROM_X(x, nx) for (; x < (nx); ++x) /* the rest of a row, after steps of several samples */
#else
#define FOR_X(x, nx) for (int x = get_global_id(0); x < (nx); x = (nx))
#define FROM_X(x, nx) for (x = get_global_id(0); x < (nx); x = (nx))
#endif

/* Index of sample (batch, y, 0) in 64 bits, since a batch may exceed 2^31 samples. */
inline size_t row_start(int batch, int y, int ny, int nx)
{
    return ((size_t)batch * ny + y) * nx;
}

inline cplx cmul(cplx a, cplx b)
{
    return (cplx)(a.x * b.x - a.y * b.y, a.x * b.y + a.y * b.x);
}

/* exp(2 pi i r) of a phase in turns, abs(r) < 2^22 so that r has a fraction.
 *
 *   r = n/2 + f,  n = rint(2 r),  abs(f) <= 1/4;   exp(2 pi i r) = (-1)^n (cos 2 pi f + i sin 2 pi f)
 *
 * In float32 by two polynomials, minimax in abs(f) <= 1/4: f P4(f^2) with 3.4e-9 for the sine,
 * 1 + f^2 Q4(f^2) with 2.5e-10 for the cosine; rounding adds up to 1.5e-7. The library's sincos
 * accepts arguments up to 1e30 and is several times slower with compilers that do not vectorise it
 * (PoCL).
 */
inline cplx cis_turns(real r)
{
#ifdef DOUBLE
    double c;
    const double s = sincos(TWO_PI * (r - rint(r)), &c);
    return (cplx)(c, s);
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
