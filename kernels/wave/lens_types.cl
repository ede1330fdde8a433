/* The kinds of lenslets of a multi-focus array.
 *
 *   kind = (q + s row) mod n,   q = column, or column - floor(row/2) on a hexagonal lattice
 *
 * so that neighbours differ: s = 1 for up to three kinds on a square lattice, 2 for more; s = 2 and
 * n = 3 on a hexagonal one. row >= 0, column >= 0.
 *
 * -DHEXAGONAL     rows are moved by half a column each
 * -DTYPES=n       kinds
 * -DTYPE_STEP=s   by how much the kind changes to the next row
 */
#ifndef CLPLEN_LENS_TYPES
#define CLPLEN_LENS_TYPES

inline int lens_type(int row, int column)
{
#ifdef HEXAGONAL
    return (column - (row >> 1) + TYPE_STEP * row) % TYPES;
#else
    return (column + TYPE_STEP * row) % TYPES;
#endif
}

#endif
