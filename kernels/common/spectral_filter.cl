/* Spectrum times a transfer function stored as a quadrant.
 *
 *   u[b, ky, kx] *= H[min(ky, Ly - ky), min(kx, Lx - kx)]
 *
 * Mapping: FOR_X of common.cl over the spectrum, FFT order. -DROWS, -DDOUBLE: see common.cl;
 * -DLANES: sixteen samples at a time (with -DROWS, in float32); -DCONJUGATE: times conj(H).
 */
#include "common.cl"

#ifdef CONJUGATE
#define FACTOR(H) ((cplx)((H).x, -(H).y))
#else
#define FACTOR(H) (H)
#endif
#ifdef LANES
#include "lanes.cl"

/* Sixteen samples times sixteen factors, in reverse order if `mirror`. */
inline void lanes(__global float *u, __global const float *H, const int mirror)
{
    float16 re, im;
    deal(H, &re, &im);
    if (mirror) {
        re = re.sfedcba9876543210;
        im = im.sfedcba9876543210;
    }
#ifdef CONJUGATE
    im = -im;
#endif
    times16(u, u, re, im);
}
#endif

__kernel void filter_spectrum(__global cplx *restrict u, __global const cplx *restrict H,
                              const int ny, const int nx)
{
    const int y = get_global_id(1);
    const size_t row = row_start(get_global_id(2), y, ny, nx);
    const size_t quadrant = (size_t)min(y, ny - y) * (nx / 2 + 1);
    int x = 0;
#ifdef LANES
    for (; x + 16 <= nx; x += 16) {
        const int mirror = x > nx / 2; /* sixteen samples across the middle are processed one by one */
        const int from = mirror ? nx - x - 15 : x;
        if (x <= nx / 2 && x + 15 > nx / 2)
            for (int k = x; k < x + 16; ++k)
                u[row + k] = cmul(u[row + k], FACTOR(H[quadrant + min(k, nx - k)]));
        else
            lanes((__global float *)(u + row + x), (__global const float *)(H + quadrant + from),
                  mirror);
    }
#endif
    FROM_X(x, nx)
        u[row + x] = cmul(u[row + x], FACTOR(H[quadrant + min(x, nx - x)]));
}
