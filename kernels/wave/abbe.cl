/* Spectra of an object illuminated by many plane waves, behind a pupil, cropped to its box.
 *
 *   out[b, j, i] = O[(j + first_y[b]) mod Ny, (i + first_x[b]) mod Nx] P[j, i]   in the h x w box
 *                = 0                                                             outside it
 *
 * first = (start of the box) - (frequency of source point b), mod N. The position of the box in the
 * window is the phase of a tilt, which does not affect the intensity.
 *
 * Mapping: FOR_X of common.cl over the window. -DROWS, -DDOUBLE: see common.cl.
 */
#include "common.cl"

__kernel void shifted_spectra(__global cplx *restrict out, __global const cplx *restrict O,
                              __global const cplx *restrict P, __global const int2 *restrict first,
                              const int h, const int w, const int ny, const int nx,
                              const int object_ny, const int object_nx)
{
    const int j = get_global_id(1);
    const int b = get_global_id(2);
    const size_t row = row_start(b, j, ny, nx);
    if (j >= h) {
        FOR_X(i, nx)
            out[row + i] = (cplx)(0);
        return;
    }
    const int y = j + first[b].x;
    const size_t from = row_start(0, y < object_ny ? y : y - object_ny, object_ny, object_nx);
    const size_t pupil = row_start(0, j, h, w);
    FOR_X(i, nx) {
        const int x = i + first[b].y;
        cplx u = (cplx)(0);
        if (i < w)
            u = cmul(O[from + (x < object_nx ? x : x - object_nx)], P[pupil + i]);
        out[row + i] = u;
    }
}
