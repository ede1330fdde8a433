/* Derivative of the transfer function of free space by the distance, in place: H *= d(ln H)/dz.
 *
 *   d(ln H)/dz = i k (c - 1) = -i k s/(1 + c),  c = sqrt(1 - s)      (propagating, s <= 1)
 *   d(ln H)/dz = -k sqrt(s - 1) - i k                                (evanescent)
 *
 * s = lam^2 (fx^2 + fy^2) from the 1-D tables of transfer.cl, (high, low) parts of (lam f)^2.
 *
 * Mapping: FOR_X of common.cl over the frequencies. -DROWS, -DDOUBLE: see common.cl.
 */
#include "common.cl"

__kernel void transfer_slope(__global cplx *restrict H, __global const real2 *restrict ax,
                             __global const real2 *restrict ay, const real k, const int ny,
                             const int nx)
{
    const int y = get_global_id(1);
    const size_t row = row_start(0, y, ny, nx);
    FOR_X(x, nx) {
        const real s = (ax[x].x + ay[y].x) + (ax[x].y + ay[y].y);
        const real turns = s <= 1 ? s / (1 + sqrt(1 - s)) : (real)1;
        const cplx slope = (cplx)(s <= 1 ? (real)0 : -k * sqrt(s - 1), -k * turns);
        H[row + x] = cmul(H[row + x], slope);
    }
}
