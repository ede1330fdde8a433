/* Transfer function of free space.
 *
 *   H(fx, fy) = exp(i k z (c - 1)),  c = sqrt(1 - s),  s = lam^2 (fx^2 + fy^2) <= 1    (propagating)
 *   H(fx, fy) = exp(-k z sqrt(s - 1)) exp(-i k z)                      s > 1, z > 0    (evanescent)
 *   H         = 0                                                      s > 1, z < 0
 *
 * times 1-D weights of the band. The carrier exp(ikz) is omitted. On the frequencies of an FFT H is
 * even in fx and fy: one quadrant of (Ly/2 + 1, Lx/2 + 1) samples is computed and mirrored when
 * applied (spectral_filter.cl). The tables may have any other frequencies.
 *
 * -DPHASE_TABLES    c - 1 = -s/2 - q^2/2 with q = s/(1 + c): the first term is a product of two 1-D
 *                   phasor tables, in double on the host, the second a residual in turns, in
 *                   pairs of float32 or in double
 * -DPHASE_FP64      the phase in double, reduced, then float32 sincos
 * -DPHASE_TWOFLOAT  the phase in pairs of float32 (Dekker 1971), for devices without fp64
 * -DLANES           sixteen samples at a time (with -DROWS and -DPHASE_TABLES, in float32), if all
 *                   waves of the band propagate: s <= 1 for every weight other than 0
 * -DROWS, -DDOUBLE  see common.cl
 *
 * Mapping: FOR_X of common.cl over the frequencies.
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
typedef double wide;
#else
typedef real wide;
#endif

/* Phase of a propagating wave relative to the carrier, as a phasor. ex, ey: tables of
 * exp(-i pi lam z f^2); ax, ay: (high, low) parts of (lam f)^2; zl: z/lam likewise. */
inline cplx propagating(cplx ex, cplx ey, real2 ax, real2 ay, real2 zl)
{
#if defined(PHASE_FP64)
    const double s = ((double)ax.x + ax.y) + ((double)ay.x + ay.y);
    const double t = -((double)zl.x + zl.y) * s / (1 + sqrt(fmax(1 - s, (double)0)));
    return cis_turns((real)(t - rint(t)));
#elif defined(PHASE_TWOFLOAT)
    return cis_turns(two_phase(ax.x, ax.y, ay.x, ay.y, zl.x, zl.y));
#elif defined(PHASE_TABLES) && defined(DOUBLE)
    const real s = ax.x + ay.x;
    const real q = s / (1 + sqrt(1 - s));
    return cmul(cmul(ex, ey), cis_turns(-(zl.x / 2 * q) * q));
#elif defined(PHASE_TABLES)
    return cmul(cmul(ex, ey), cis_turns(two_residual(ax.x, ax.y, ay.x, ay.y, zl.x, zl.y)));
#else
#error "choose PHASE_TABLES, PHASE_FP64 or PHASE_TWOFLOAT"
#endif
}

#ifdef LANES
/* Sixteen samples. ex, ax, wx: parts of the tables of the samples; ey, ay, wy: entries of the row. */
inline void lanes(__global float *H, __global const float *ex, __global const float *ax,
                  __global const float *wx, const cplx ey, const real2 ay, const real wy,
                  const real2 zl)
{
    float16 re, im, high, low, cr, ci;
    deal(ax, &high, &low);
    cis16(two_residual16(high, low, ay.x, ay.y, zl.x, zl.y), &cr, &ci);
    deal(ex, &re, &im);
    const float16 weight = load16(wx) * wy;
    const float16 tr = weight * (re * ey.x - im * ey.y), ti = weight * (re * ey.y + im * ey.x);
    merge(H, tr * cr - ti * ci, tr * ci + ti * cr);
}
#endif

__kernel void transfer(__global cplx *restrict H, __global const cplx *restrict ex,
                       __global const cplx *restrict ey, __global const real2 *restrict ax,
                       __global const real2 *restrict ay, __global const real *restrict wx,
                       __global const real *restrict wy, const real2 zl, const cplx carrier,
                       const int ny, const int nx)
{
    const int y = get_global_id(1);
    const size_t row = row_start(0, y, ny, nx);
    int x = 0;
#ifdef LANES
    for (; x + 16 <= nx; x += 16)
        lanes((__global float *)(H + row + x), (__global const float *)(ex + x),
              (__global const float *)(ax + x), wx + x, ey[y], ay[y], wy[y], zl);
#endif
    FROM_X(x, nx) {
        const wide s = ((wide)ax[x].x + ay[y].x) + ((wide)ax[x].y + ay[y].y);
        const real weight = wx[x] * wy[y];
        cplx h = (cplx)(0);
        if (weight > 0) {
            if (s <= 1)
                h = propagating(ex[x], ey[y], ax[x], ay[y], zl);
            else if (zl.x > 0)
                h = carrier * (real)exp(-TWO_PI * zl.x * sqrt(s - 1));
        }
        H[row + x] = weight * h;
    }
}
