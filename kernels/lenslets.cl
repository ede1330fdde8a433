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
 * -DFILTERED        A is a step across the rim without its frequencies beyond the samples' band
 *                   (rim_weights.cl); neighbours overlap there with their own phases
 * -DROWS, -DDOUBLE  see common.cl
 *
 * Mapping: FOR_X of common.cl.
 */
#include "lens_types.cl"
#include "lenslet_coverage.cl"
#include "rim_weights.cl"

#ifdef FULL
#define IS_FULL true
#else
#define IS_FULL false
#endif

#ifdef FILTERED
/* Weight at offset (a, b) from a lenslet's centre, in pitches; `per_sample` samples a pitch. */
inline real filtered_rim(real a, real b, real radius, real per_sample,
                         __global const real *restrict rim, int rim_size)
{
#ifdef FULL
    const real x = fabs(a), y = fabs(b);
#ifdef HEXAGONAL
    const real across = fmax(x, x / 2 + y * ROW_HEIGHT);
    return rim_weight((radius - across) * per_sample, rim, rim_size);
#else
    return rim_weight((radius - x) * per_sample, rim, rim_size)
        * rim_weight((radius - y) * per_sample, rim, rim_size);
#endif
#else
    return rim_weight((radius - sqrt(a * a + b * b)) * per_sample, rim, rim_size);
#endif
}

/* Sum over the nearest lenslet and its neighbours of their weights times their phases. */
inline cplx filtered(Lenslet l, real radius, real per_sample, int rows, int columns,
                     __global const real *restrict turns, __global const real *restrict rim,
                     int rim_size)
{
#ifdef FULL
    const real beyond = radius * (real)1.4143f + 2 * RIM / per_sample; /* the corners of a cell */
#else
    const real beyond = radius + RIM / per_sample;
#endif
    cplx sum = (cplx)(0);
    for (int i = -1; i <= 1; ++i) {
        const int row = l.row + i;
        if (row < 0 || row >= rows)
            continue;
#ifdef HEXAGONAL
        const real shift = ((row & 1) - (l.row & 1)) * (real)0.5f;
#else
        const real shift = 0;
#endif
        for (int k = -1; k <= 1; ++k) {
            const int column = l.column + k;
            if (column < 0 || column >= columns)
                continue;
            const real a = l.a - k - shift, b = l.b - i * ROW_HEIGHT;
            if (a * a + b * b > beyond * beyond)
                continue;
            const real weight = filtered_rim(a, b, radius, per_sample, rim, rim_size);
            if (weight != 0)
                sum += weight * cis_turns(-turns[lens_type(row, column)] * (a * a + b * b));
        }
    }
    return sum;
}
#endif

__kernel void lenslets(__global cplx *restrict t, __global const real2 *restrict a_of_y,
                       __global const real2 *restrict b_of_y,
                       __global const real2 *restrict a_of_x,
                       __global const real2 *restrict b_of_x, __global const real *restrict turns, const real radius,
                       const real2 turn, const real angle, const real hy, const real hx,
                       __global const real *restrict rim, const int rim_size,
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
#ifdef FILTERED
        const real per_sample = (real)0.5f / hx, deep = radius - RIM / per_sample;
        if (!(deep > 0 && r2 < deep * deep)) {
            t[row + x] = filtered(l, radius, per_sample, rows, columns, turns, rim, rim_size);
            continue;
        }
#endif
        real amplitude = 1;
        const bool inner = IS_FULL && radius >= (real)0.5f && is_inner(l, rows, columns);
        const real room = radius - reach;
        if (!inner && !(room > 0 && r2 < room * room))
            amplitude = coverage(l, radius, IS_FULL, turn, angle, hx, hy, rows, columns);
        t[row + x] = amplitude * cis_turns(-turns[lens_type(l.row, l.column)] * r2);
    }
}
