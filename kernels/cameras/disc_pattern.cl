/* 2 J1(v)/v, the far field of a uniform coherent disc, from a table of (value, slope times step)
 * over v by cubic Hermite interpolation; the last entry holds beyond the table.
 */
#ifndef CLPLEN_DISC_PATTERN
#define CLPLEN_DISC_PATTERN

#include "common.cl"

inline real disc_pattern(real v, real per_step, __global const real2 *restrict table, int last)
{
    const real place = fmin(v * per_step, (real)last);
    const int i = min((int)place, last - 1);
    const real t = place - i;
    const real2 a = table[i], b = table[i + 1];
    const real rise = b.x - a.x;
    return a.x + t * (a.y + t * ((3 * rise - 2 * a.y - b.y) + t * (a.y + b.y - 2 * rise)));
}

#endif
