/* Fields of point sources in the pupil of a lens, behind the lens.
 *
 *   u_n(y, x) = A(y, x) exp(i k (r - z_n)) 2 J1(v)/v exp(-i pi (x^2 + y^2)/(lam f)),
 *   rho = distance of (x, y) from the foot of source n, r = sqrt(rho^2 + z_n^2), v = scale_n rho
 *
 * with r - z = rho^2/(2z) - (r - z)^2/(2z): the quadratic phases of source and lens are together a
 * product of two 1-D phasor tables ty, tx made in double on the host; the rest is a small residual
 * in turns. A: covered fraction of the cell by the circular aperture of radius R about the axis.
 * 2 J1(v)/v: see disc_pattern.cl. Outside the aperture nothing is computed.
 *
 * source: (z high, z low, scale, -) of each source; rho_y, rho_x: (high, low) distances from the foot
 * of each source along y and x; wavelength: (high, low).
 * -DRESIDUAL_FP64: the residual in double, for sources so near that it takes many turns.
 * Mapping: FOR_X of common.cl, axis 2 = source. -DROWS, -DDOUBLE: see common.cl.
 */
#include "coverage.cl"
#include "disc_pattern.cl"

#ifdef RESIDUAL_FP64
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
typedef double wide;
#else
typedef real wide;
#endif

#ifdef DOUBLE
typedef double4 real4;
#else
typedef float4 real4;
#endif

__kernel void point_sources(__global cplx *restrict u, __global const cplx *restrict ty,
                            __global const cplx *restrict tx, __global const real4 *restrict source,
                            __global const real2 *restrict table, const int last,
                            const real per_step, const real2 wavelength,
                            __global const real2 *restrict rho_y,
                            __global const real2 *restrict rho_x,
                            __global const real *restrict ys, __global const real *restrict xs,
                            const real R, const real hy, const real hx, const int ny, const int nx)
{
    const int y = get_global_id(1);
    const int n = get_global_id(2);
    const size_t row = row_start(n, y, ny, nx);
    const bool dark = fabs(ys[y]) - hy >= R;
    const real4 s = source[n];
    const cplx t = ty[(size_t)n * ny + y];
    const wide z = (wide)s.x + s.y;
    const wide lam = (wide)wavelength.x + wavelength.y;
    const wide dy = (wide)rho_y[(size_t)n * ny + y].x + rho_y[(size_t)n * ny + y].y;
    FOR_X(x, nx) {
        cplx value = (cplx)(0);
        if (!dark && fabs(xs[x]) - hx < R) {
            const real A = disc_coverage(-xs[x], -ys[y], R, hx, hy);
            const real2 apart = rho_x[(size_t)n * nx + x];
            const wide dx = (wide)apart.x + apart.y;
            const wide rho2 = dx * dx + dy * dy;
            const wide beyond = rho2 / (sqrt(rho2 + z * z) + z); /* r - z */
            const wide residual = -(beyond / (2 * z)) * (beyond / lam);
            const cplx sphere = cis_turns((real)(residual - rint(residual)));
            const real amplitude = A * disc_pattern(s.z * sqrt((real)rho2), per_step, table, last);
            value = amplitude * cmul(cmul(t, tx[(size_t)n * nx + x]), sphere);
        }
        u[row + x] = value;
    }
}
