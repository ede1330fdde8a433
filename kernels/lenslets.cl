/* Transmission of a microlens array in closed form at real coordinates.
 *
 *   t(y, x) = A(y, x) exp(-i pi r^2/(lam f)),  r = distance to the nearest lenslet's centre,
 *   f = that of the lenslet's kind, turns[kind] = pitch^2/(2 lam f)
 *   A = fraction of the sample's cell that the lenslets' apertures cover
 *
 * Coordinates are in pitches along the array's own columns (a) and rows (b): the contributions of x
 * and y to each are 1-D tables of (integer, fraction) made in double on the host, so that neither a
 * sub-pixel pitch nor a far corner costs phase in float32.
 *
 * -DHEXAGONAL       rows sqrt(3)/2 pitch apart, odd rows shifted by +1/2; square lattice otherwise
 * -DFULL            the aperture is the lattice cell (square or hexagon); a disc otherwise
 * -DTYPES=n         kinds of lenslets; their order on the lattice: lens_types.cl
 * -DTYPE_STEP=s     see lens_types.cl
 * -DROWS, -DDOUBLE  see common.cl
 *
 * Mapping: FOR_X of common.cl.
 */
#include "lens_types.cl"
#include "lenslet_coverage.cl"

#ifdef FULL
#define IS_FULL true
#else
#define IS_FULL false
#endif

__kernel void lenslets(__global cplx *restrict t, __global const real2 *restrict a_of_y,
                       __global const real2 *restrict b_of_y,
                       __global const real2 *restrict a_of_x,
                       __global const real2 *restrict b_of_x, __global const real *restrict turns, const real radius,
                       const real2 turn, const real angle, const real hy, const real hx,
                       const int rows, const int columns, const int ny, const int nx)
{
    const int y = get_global_id(1);
    const size_t row = row_start(0, y, ny, nx);
    const real reach = fabs(hx) + fabs(hy);
    FOR_X(x, nx) {
        const real2 a = a_of_y[y] + a_of_x[x];
        const real2 b = b_of_y[y] + b_of_x[x];
        const Lenslet l = nearest(a, b, rows, columns);
        const real r2 = l.a * l.a + l.b * l.b;
        real amplitude = 1;
        const bool inner = IS_FULL && radius >= (real)0.5f && is_inner(l, rows, columns);
        const real room = radius - reach;
        if (!inner && !(room > 0 && r2 < room * room))
            amplitude = coverage(l, radius, IS_FULL, turn, angle, hx, hy, rows, columns);
        t[row + x] = amplitude * cis_turns(-turns[lens_type(l.row, l.column)] * r2);
    }
}
