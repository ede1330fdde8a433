/* Sums over the samples of a lenslet, row by row.
 *
 * boxes: (first, end) rows and (first, end) columns of each lenslet's samples. out[lenslet, part, sum]:
 * part p has rows p, p + parts, ... of the box. Each row is summed, and rows are added with
 * compensation (Kahan 1965).
 *
 * SUMS: number of sums, a macro of the including file.
 */
#ifndef CLPLEN_LENSLET_SUMS
#define CLPLEN_LENSLET_SUMS

#include "common.cl"

/* Add the sums of a row. */
inline void add_line(real *total, real *lost, const real *line)
{
    for (int k = 0; k < SUMS; ++k) {
        const real term = line[k] - lost[k];
        const real next = total[k] + term;
        lost[k] = (next - total[k]) - term;
        total[k] = next;
    }
}

#endif
