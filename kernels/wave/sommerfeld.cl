/* Sampled impulse response of the first Rayleigh-Sommerfeld integral (Goodman 2005, eq. 3-43).
 *
 *   h(x, y) dx dy = z dx dy/(2 pi r^2) (1/r - ik) exp(ik(r - z)),  r = sqrt(x^2 + y^2 + z^2), z > 0
 *                 = scale/c^2 (1/(2 pi z c/lam) - i) exp(2 pi i (z/lam) q)
 *   s = (x^2 + y^2)/z^2,  c = r/z = sqrt(1 + s),  q = r/z - 1 = s/(1 + c),  scale = dx dy/(lam z)
 *
 * The carrier exp(ikz) is omitted; z < 0 is the conjugate (side = -1). h is even in x and y, so one
 * quadrant of (Ly/2 + 1, Lx/2 + 1) samples is computed and unfolded.
 *
 * -DPHASE_TABLES    q = s/2 - q^2/2: the first term is a product of two 1-D phasor tables, in
 *                   double on the host, the second a residual in turns, in pairs of float32 or in
 *                   double
 * -DPHASE_FP64      the phase in double, reduced, then float32 sincos
 * -DPHASE_TWOFLOAT  the phase in pairs of float32 (Dekker 1971), for devices without fp64
 * -DROWS, -DDOUBLE  see common.cl
 *
 * Mapping: FOR_X of common.cl over the quadrant (sommerfeld) or the window (unfold).
 */
#include "common.cl"
#ifndef DOUBLE
#include "twofloat.cl"
#endif
#ifdef PHASE_FP64
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
#endif

/* exp(ik(r - z)). ex, ey: tables of exp(i pi x^2/(lam z)); ax, ay: (high, low) parts of (x/z)^2;
 * zl: z/lam likewise; q: r/z - 1. */
inline cplx spherical(cplx ex, cplx ey, real2 ax, real2 ay, real2 zl, real q)
{
#if defined(PHASE_FP64)
    const double s = ((double)ax.x + ax.y) + ((double)ay.x + ay.y);
    const double t = ((double)zl.x + zl.y) * s / (1 + sqrt(1 + s));
    return cis_turns((real)(t - rint(t)));
#elif defined(PHASE_TWOFLOAT)
    /* -(z/lam) s/(1 + sqrt(1 - s)) of twofloat.cl, with -s for s */
    return cis_turns(two_phase(-ax.x, -ax.y, -ay.x, -ay.y, zl.x, zl.y));
#elif defined(PHASE_TABLES) && defined(DOUBLE)
    return cmul(cmul(ex, ey), cis_turns(-(zl.x / 2 * q) * q));
#elif defined(PHASE_TABLES)
    return cmul(cmul(ex, ey), cis_turns(two_residual(-ax.x, -ax.y, -ay.x, -ay.y, zl.x, zl.y)));
#else
#error "choose PHASE_TABLES, PHASE_FP64 or PHASE_TWOFLOAT"
#endif
}

__kernel void sommerfeld(__global cplx *restrict h, __global const cplx *restrict ex,
                         __global const cplx *restrict ey, __global const real2 *restrict ax,
                         __global const real2 *restrict ay, const real2 zl, const real scale,
                         const real side, const int ny, const int nx)
{
    const int y = get_global_id(1);
    const size_t row = row_start(0, y, ny, nx);
    FOR_X(x, nx) {
        const real s = ax[x].x + ay[y].x;
        const real c = sqrt(1 + s);
        const real near = 1 / (TWO_PI * zl.x * c);
        const cplx wave = spherical(ex[x], ey[y], ax[x], ay[y], zl, s / (1 + c));
        const cplx value = scale / (1 + s) * cmul((cplx)(near, -1), wave);
        h[row + x] = (cplx)(value.x, side * value.y);
    }
}

/* out[y, x] = h[min(y, ny - y), min(x, nx - x)]: the window in circular order. */
__kernel void unfold(__global cplx *restrict out, __global const cplx *restrict h, const int ny,
                     const int nx)
{
    const int y = get_global_id(1);
    const size_t row = row_start(0, y, ny, nx);
    const size_t quadrant = (size_t)min(y, ny - y) * (nx / 2 + 1);
    FOR_X(x, nx)
        out[row + x] = h[quadrant + min(x, nx - x)];
}
