/* Covered fraction of a sample's cell by the apertures of a lattice of lenslets.
 *
 * Lengths are in pitches. (a, b) of a Lenslet is the sample's offset from the nearest centre along
 * the array's columns and rows, rotated by `turn` = (cos, sin) of `angle` to the sensor's axes.
 *
 * -DHEXAGONAL    the lattice, and full cells are hexagons; square otherwise
 * -DDOUBLE       see common.cl
 */
#ifndef CLPLEN_LENSLET_COVERAGE
#define CLPLEN_LENSLET_COVERAGE

#include "coverage.cl"
#include "nearest_lenslet.cl"

#ifdef HEXAGONAL
#define SIDES 6
#else
#define SIDES 4
#endif

/* Aperture of the lenslet at offset (a, b) from the sample: a lattice cell (full) or a disc. */
inline real one_coverage(real a, real b, real radius, bool full, real2 turn, real angle, real hx,
                         real hy)
{
    const real cx = -(a * turn.x - b * turn.y), cy = -(a * turn.y + b * turn.x);
    return full ? polygon_coverage(cx, cy, radius, SIDES, angle, hx, hy)
                : disc_coverage(cx, cy, radius, hx, hy);
}

/* Sum over the nearest lenslet and its neighbours on the lattice (apertures do not overlap). */
inline real coverage(Lenslet l, real radius, bool full, real2 turn, real angle, real hx, real hy,
                     int rows, int columns)
{
    real sum = 0;
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
            if (column >= 0 && column < columns)
                sum += one_coverage(l.a - k - shift, l.b - i * ROW_HEIGHT, radius, full, turn,
                                    angle, hx, hy);
        }
    }
    return fmin(sum, (real)1);
}

/* True if a lenslet has all neighbours; no full cell then borders on an opaque area. */
inline bool is_inner(Lenslet l, int rows, int columns)
{
    return l.row > 0 && l.row < rows - 1 && l.column > 0 && l.column < columns - 1;
}

#endif
