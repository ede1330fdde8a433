/* Spectra of points behind an objective: the pupil of each point's plane, moved to its place.
 *
 *   out[b, y, x] = P[plane[b], y, x] ty[b, y] tx[b, x]
 *
 * P (aperture, apodisation, defocus) and the tables exp(-2 pi i f M x0) are made in double on the
 * host, so that neither a far plane nor a far place costs phase in float32.
 * Mapping: FOR_X of common.cl. -DROWS, -DDOUBLE: see common.cl.
 */
#include "common.cl"

__kernel void point_spectra(__global cplx *restrict out, __global const cplx *restrict P,
                            __global const int *restrict plane, __global const cplx *restrict ty,
                            __global const cplx *restrict tx, const int ny, const int nx)
{
    const int y = get_global_id(1), b = get_global_id(2);
    const size_t row = row_start(b, y, ny, nx);
    const size_t pupil = row_start(plane[b], y, ny, nx);
    const cplx t = ty[(size_t)b * ny + y];
    __global const cplx *shift = tx + (size_t)b * nx;
    FOR_X(x, nx)
        out[row + x] = cmul(P[pupil + x], cmul(t, shift[x]));
}
