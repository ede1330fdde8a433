/* A field times a spherical phase: stigmatic lenses (z = -f) and point sources.
 *
 *   out[b, y, x] = in[b, y, x] exp(i k (r - |z|) sign z) A,  r = sqrt(rho^2 + z^2),
 *   rho^2 = x^2 + y^2 from the foot of the centre,  A = 1, or 1/r with -DSOURCE
 *
 * With s = rho^2/z^2 and q = s/(1 + sqrt(1 + s)) = r/|z| - 1 the phase is (z/lam) q turns.
 *
 * -DSOURCE          the amplitude 1/r of a point source
 * -DPHASE_TABLES    q = s/2 - q^2/2: the first term is a product of two 1-D phasor tables, in
 *                   double on the host, the second a residual in turns, in pairs of float32 or in
 *                   double
 * -DPHASE_FP64      the phase in double, reduced, then float32 sincos
 * -DPHASE_TWOFLOAT  the phase in pairs of float32 (Dekker 1971), for devices without fp64
 * -DLANES           sixteen samples at a time (with -DROWS and -DPHASE_TABLES, in float32)
 * -DROWS, -DDOUBLE  see common.cl
 *
 * ey, ex: tables of exp(i pi y^2/(lam z)); ay, ax: (high, low) parts of (y/z)^2; zl: of z/lam.
 * Mapping: FOR_X of common.cl. in and out may be the same array.
 */
#include "common.cl"
#ifdef LANES
#include "lanes.cl"
#endif
#ifndef DOUBLE
#include "twofloat.cl"
#endif
#ifdef PHASE_FP64
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
#endif

inline cplx spherical(cplx ey, cplx ex, real2 ay, real2 ax, real2 zl)
{
#if defined(PHASE_FP64)
    const double s = ((double)ax.x + ax.y) + ((double)ay.x + ay.y);
    const double t = ((double)zl.x + zl.y) * s / (1 + sqrt(1 + s));
    return cis_turns((real)(t - rint(t)));
#elif defined(PHASE_TWOFLOAT)
    return cis_turns(two_phase(-ax.x, -ax.y, -ay.x, -ay.y, zl.x, zl.y)); /* -(z/lam) (-s)/(1 + sqrt(1 - (-s))) */
#elif defined(PHASE_TABLES) && defined(DOUBLE)
    const real s = ax.x + ay.x;
    const real q = s / (1 + sqrt(1 + s));
    return cmul(cmul(ey, ex), cis_turns(-(zl.x / 2 * q) * q));
#elif defined(PHASE_TABLES)
    return cmul(cmul(ey, ex), cis_turns(two_residual(-ax.x, -ax.y, -ay.x, -ay.y, zl.x, zl.y)));
#else
#error "choose PHASE_TABLES, PHASE_FP64 or PHASE_TWOFLOAT"
#endif
}

#ifdef LANES
/* Sixteen samples. ex, ax: parts of the tables of the samples; ey, ay: entries of the row. */
inline void lanes(__global float *out, __global const float *in, __global const float *ex,
                  __global const float *ax, const cplx ey, const real2 ay, const real2 zl,
                  const real per_z)
{
    float16 re, im, high, low, cr, ci;
    deal(ax, &high, &low);
    cis16(two_residual16(-high, -low, -ay.x, -ay.y, zl.x, zl.y), &cr, &ci);
    deal(ex, &re, &im);
    float16 tr = re * ey.x - im * ey.y, ti = re * ey.y + im * ey.x;
#ifdef SOURCE
    const float16 fading = per_z / sqrt(1 + (high + ay.x));
    tr *= fading;
    ti *= fading;
#endif
    times16(out, in, tr * cr - ti * ci, tr * ci + ti * cr);
}
#endif

__kernel void sphere(__global cplx *out, __global const cplx *in, __global const cplx *restrict ey,
                     __global const cplx *restrict ex, __global const real2 *restrict ay,
                     __global const real2 *restrict ax, const real2 zl, const real per_z,
                     const int ny, const int nx)
{
    const int y = get_global_id(1);
    const size_t row = row_start(get_global_id(2), y, ny, nx);
    int x = 0;
#ifdef LANES
    for (; x + 16 <= nx; x += 16)
        lanes((__global float *)(out + row + x), (__global const float *)(in + row + x),
              (__global const float *)(ex + x), (__global const float *)(ax + x), ey[y], ay[y], zl,
              per_z);
#endif
    FROM_X(x, nx) {
        cplx t = spherical(ey[y], ex[x], ay[y], ax[x], zl);
#ifdef SOURCE
        t *= per_z / sqrt(1 + (ax[x].x + ay[y].x));
#endif
        out[row + x] = cmul(in[row + x], t);
    }
}
