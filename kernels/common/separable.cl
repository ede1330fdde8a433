/* A field times a product of two 1-D tables: thin lenses, tilts, rectangular apertures.
 *
 *   out[b, y, x] = in[b, y, x] ty[y] tx[x]
 *
 * The tables are computed in double precision on the host, so that float32 suffices for the phase.
 * Mapping: FOR_X of common.cl. in and out may be the same array. -DROWS, -DDOUBLE: see common.cl;
 * -DLANES: sixteen samples at a time (with -DROWS, in float32).
 */
#include "common.cl"
#ifdef LANES
#include "lanes.cl"
#endif

__kernel void multiply_separable(__global cplx *out, __global const cplx *in,
                                 __global const cplx *restrict ty,
                                 __global const cplx *restrict tx, const int ny, const int nx)
{
    const int y = get_global_id(1);
    const size_t row = row_start(get_global_id(2), y, ny, nx);
    const cplx t = ty[y];
    int x = 0;
#ifdef LANES
    for (; x + 16 <= nx; x += 16) {
        float16 re, im;
        deal((__global const float *)(tx + x), &re, &im);
        times16((__global float *)(out + row + x), (__global const float *)(in + row + x),
                t.x * re - t.y * im, t.x * im + t.y * re);
    }
#endif
    FROM_X(x, nx)
        out[row + x] = cmul(in[row + x], cmul(t, tx[x]));
}
