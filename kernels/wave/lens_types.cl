/* The kinds of lenslets of a multi-focus array.
 *
 *   kind = (q + s row) mod n,   q = column, or column - floor(row/2) on a hexagonal lattice
 *
 * Neighbours differ: s = 1 for up to three kinds on a square lattice, 2 for more; s = 2 and n = 3 on
 * a hexagonal lattice. row >= 0, column >= 0.
 *
 * -DHEXAGONAL     odd rows are shifted by half a column
 * -DTYPES=n       number of kinds
 * -DTYPE_STEP=s   step of the kind from row to row
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
