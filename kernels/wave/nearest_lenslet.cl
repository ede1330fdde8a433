/* Nearest lenslet of a sample, on a square or hexagonal lattice.
 *
 * Coordinates a along the columns (in pitches) and b along the rows (in rows) are (integer,
 * fraction), so that float32 is accurate at sub-pixel pitches and far corners.
 *
 * -DHEXAGONAL   rows sqrt(3)/2 pitch apart, odd rows shifted by +1/2; square lattice otherwise
 */
#ifndef CLPLEN_NEAREST_LENSLET
#define CLPLEN_NEAREST_LENSLET

#include "common.cl"

#ifdef HEXAGONAL
#define ROW_HEIGHT ((real)sqrt((real)3) / 2)
#else
#define ROW_HEIGHT ((real)1)
#endif

/* Offset of the sample from lenslet (row, column), in pitches, and the lenslet's indices. */
typedef struct {
    int row, column;
    real a, b;
} Lenslet;

inline Lenslet in_row(int row, real2 a, real2 b, int columns)
{
    Lenslet l;
    l.row = row;
    l.b = ((b.x - row) + b.y) * ROW_HEIGHT;
#ifdef HEXAGONAL
    const real shift = (row & 1) * (real)0.5f;
#else
    const real shift = 0;
#endif
    l.column = clamp((int)a.x + (int)rint(a.y - shift), 0, columns - 1);
    l.a = ((a.x - l.column) + a.y) - shift;
    return l;
}

inline Lenslet nearest(real2 a, real2 b, int rows, int columns)
{
    const int row = clamp((int)b.x + (int)rint(b.y), 0, rows - 1);
    Lenslet best = in_row(row, a, b, columns);
#ifdef HEXAGONAL
    for (int step = -1; step <= 1; step += 2) {
        const Lenslet l = in_row(clamp(row + step, 0, rows - 1), a, b, columns);
        if (l.a * l.a + l.b * l.b < best.a * best.a + best.b * best.b)
            best = l;
    }
#endif
    return best;
}

#endif
