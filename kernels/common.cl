/* Types, loops and phase arithmetic shared by all kernels.
 *
 * -DDOUBLE   the wave tower in float64 (needs cl_khr_fp64); float32 otherwise
 * -DROWS     one work-item owns a whole row (CPUs: the compiler vectorises the loop);
 *            otherwise one work-item owns one sample (GPUs)
 *
 * Mapping of every kernel written with FOR_X: axis 0 = x, axis 1 = y, axis 2 = batch.
 *
 * Functions are plain `inline`: Oclgrind 21.10 finds no kernel in what becomes of `static inline`
 * functions that return structures.
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
#else
#define FOR_X(x, nx) for (int x = get_global_id(0); x < (nx); x = (nx))
#endif

/* Index of sample (batch, y, x), 64 bits because a batch may pass 2^31 samples. */
inline size_t row_start(int batch, int y, int ny, int nx)
{
    return ((size_t)batch * ny + y) * nx;
}

inline cplx cmul(cplx a, cplx b)
{
    return (cplx)(a.x * b.x - a.y * b.y, a.x * b.y + a.y * b.x);
}

/* exp(2 pi i r) for a phase r in turns, already reduced to a few turns. */
inline cplx cis_turns(real r)
{
    real c;
    real s = sincos(TWO_PI * (r - rint(r)), &c);
    return (cplx)(c, s);
}

#endif
