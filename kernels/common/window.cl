/* Field in a larger or smaller window about the same central sample.
 *
 *   out[b, y, x] = in[b, y + shift_y, x + shift_x], 0 where that lies outside
 *
 * With shift = N_in//2 - N_out//2 sample N//2 stays at N//2 for even and odd lengths: zero padding,
 * cropping and (same shape) copying in one kernel.
 *
 * Mapping: FOR_X of common.cl over the output. -DROWS, -DDOUBLE: see common.cl.
 */
#include "common.cl"

__kernel void window(__global cplx *restrict out, __global const cplx *restrict in, const int ny,
                     const int nx, const int in_ny, const int in_nx, const int shift_y,
                     const int shift_x)
{
    const int y = get_global_id(1);
    const int b = get_global_id(2);
    const size_t row = row_start(b, y, ny, nx);
    const int from_y = y + shift_y;
    if (from_y < 0 || from_y >= in_ny) {
        FOR_X(x, nx)
            out[row + x] = (cplx)(0);
        return;
    }
    const size_t from = row_start(b, from_y, in_ny, in_nx);
    FOR_X(x, nx) {
        const int from_x = x + shift_x;
        out[row + x] = from_x >= 0 && from_x < in_nx ? in[from + from_x] : (cplx)(0);
    }
}
