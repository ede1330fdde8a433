/* A circular aperture, area-weighted: out[b, y, x] = in[b, y, x] (covered fraction of the cell).
 *
 * y, x: coordinates of the samples relative to the centre of the disc, x rising.
 * Mapping: FOR_X of common.cl; an item with a row processes STRETCH samples at a time, which are all
 * inside, all outside, or partly at the rim. in and out may be the same array. -DROWS, -DDOUBLE: see
 * common.cl.
 */
#include "coverage.cl"
#define STRETCH 16

/* True if a cell about (x, y) lies inside, where disc_coverage is 1. */
inline bool within(real x, real y, real R, real hx, real hy)
{
    const real ax = fabs(x) + hx, ay = fabs(y) + hy;
    return ax * ax + ay * ay <= R * R;
}

__kernel void disc(__global cplx *out, __global const cplx *in, __global const real *restrict ys,
                   __global const real *restrict xs, const real R, const real hy, const real hx,
                   const int ny, const int nx)
{
    const int y = get_global_id(1);
    const size_t row = row_start(get_global_id(2), y, ny, nx);
    int x = 0;
#ifdef ROWS
    const real near = fmax(fabs(ys[y]) - hy, (real)0);
    const real chord = sqrt(fmax(R * R - near * near, (real)0)); /* half of the longest chord */
    for (; x + STRETCH <= nx; x += STRETCH) {
        const real first = xs[x], last = xs[x + STRETCH - 1];
        if (first - hx >= chord || last + hx <= -chord) {
            for (int k = x; k < x + STRETCH; ++k)
                out[row + k] = (cplx)(0);
        } else if (within(first, ys[y], R, hx, hy) && within(last, ys[y], R, hx, hy)) {
            for (int k = x; k < x + STRETCH; ++k)
                out[row + k] = in[row + k];
        } else {
            for (int k = x; k < x + STRETCH; ++k)
                out[row + k] = in[row + k] * disc_coverage(-xs[k], -ys[y], R, hx, hy);
        }
    }
#endif
    FROM_X(x, nx)
        out[row + x] = in[row + x] * disc_coverage(-xs[x], -ys[y], R, hx, hy);
}
