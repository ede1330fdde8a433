/* Covered fraction of a sample's cell, for area-weighted apertures.
 *
 *   disc_coverage      cell [-hx, hx] x [-hy, hy] about the sample, disc of radius R centred at
 *                      (cx, cy) relative to the sample: strips of exact chord, midpoint rule along
 *                      the axis on which the rim is less steep; error < 2e-4 for R >= 2 samples
 *   polygon_coverage   the same cell and a regular polygon of n sides (inradius a, first normal at
 *                      angle turn): the cell clipped by each side in turn (Sutherland and Hodgman
 *                      1974), then its area by the shoelace formula; exact
 */
#ifndef CLPLEN_COVERAGE
#define CLPLEN_COVERAGE

#include "common.cl"

#define STRIPS 32
#define CORNERS 12 /* a rectangle clipped by at most six sides has ten corners */

inline real disc_coverage(real cx, real cy, real R, real hx, real hy)
{
    const real ax = fabs(cx), ay = fabs(cy);
    const real far2 = (ax + hx) * (ax + hx) + (ay + hy) * (ay + hy);
    if (far2 <= R * R)
        return 1;
    const real nx = fmax(ax - hx, (real)0), ny = fmax(ay - hy, (real)0);
    if (nx * nx + ny * ny >= R * R)
        return 0;
    /* along: the axis of the chords; across: the axis of the strips */
    const bool along_x = ax * hy >= ay * hx;
    const real along = along_x ? ax : ay, across = along_x ? ay : ax;
    const real ha = along_x ? hx : hy, hs = along_x ? hy : hx;
    real sum = 0;
    for (int i = 0; i < STRIPS; ++i) {
        const real t = across + hs * ((2 * i + 1) / (real)STRIPS - 1);
        const real half_chord = sqrt(fmax(R * R - t * t, (real)0));
        sum += fmax(fmin(along + half_chord, ha) - fmax(along - half_chord, -ha), (real)0);
    }
    return sum / (2 * ha * STRIPS);
}

inline real polygon_coverage(real cx, real cy, real a, int sides, real turn, real hx, real hy)
{
    real2 corner[CORNERS], kept[CORNERS];
    int count = 4;
    corner[0] = (real2)(-hx, -hy);
    corner[1] = (real2)(hx, -hy);
    corner[2] = (real2)(hx, hy);
    corner[3] = (real2)(-hx, hy);
    for (int side = 0; side < sides && count > 0; ++side) {
        real nx;
        const real ny = sincos(turn + TWO_PI * side / sides, &nx);
        int n = 0;
        for (int i = 0; i < count; ++i) {
            const real2 p = corner[i], q = corner[i + 1 < count ? i + 1 : 0];
            const real in_p = a - ((p.x - cx) * nx + (p.y - cy) * ny);
            const real in_q = a - ((q.x - cx) * nx + (q.y - cy) * ny);
            if (in_p >= 0 && n < CORNERS)
                kept[n++] = p;
            if ((in_p >= 0) != (in_q >= 0) && n < CORNERS)
                kept[n++] = p + (q - p) * (in_p / (in_p - in_q));
        }
        count = n;
        for (int i = 0; i < count; ++i)
            corner[i] = kept[i];
    }
    real twice = 0;
    for (int i = 0; i < count; ++i) {
        const real2 p = corner[i], q = corner[i + 1 < count ? i + 1 : 0];
        twice += p.x * q.y - p.y * q.x;
    }
    return fmin(twice / (8 * hx * hy), (real)1);
}

#endif
