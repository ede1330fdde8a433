/* Views of a raw image over views of its white image, and the colours of a Bayer mosaic.
 *
 *   divide    L[j, c] = raw[j] / max(white[j], floor)
 *   colours   L[v, u, y, x, c] = (sum_ab g_a g_b raw[v, u, y+a, x+b] + e (first + second))
 *                              / (likewise of the white image),   a, b = -1, 0, 1
 *
 * `raw` and `white` of colours are views of a mosaic that is 0 where the pixel has another colour:
 * normalised convolution (Knutsson and Westin 1993). g = 1, g' = 1/32 fills gaps from the
 * same view of neighbouring lenslets. Remaining gaps are filled from the colour's own pixels,
 * interpolated within a lenslet: `first` and `second` (the two greens, or the same twice), e = 1/512.
 *
 * Mapping: FOR_X of common.cl over a row; axis 1 = row of a view; axis 2 = view. -DROWS: see
 * common.cl.
 */
#include "common.cl"

__kernel void divide(__global float *restrict L, __global const float *restrict raw,
                     __global const float *restrict white, const float least, const int ny,
                     const int nx, const int channels, const int channel)
{
    const size_t at = row_start(get_global_id(2), get_global_id(1), ny, nx);
    FOR_X(x, nx) {
        L[(at + x) * channels + channel] = raw[at + x] / fmax(white[at + x], least);
    }
}

/* Weighted sum over the three by three lenslets about (y, x) of one view. */
inline float around(__global const float *restrict view, int y, int x, int ny, int nx)
{
    float total = 0;
    for (int b = max(y - 1, 0); b <= min(y + 1, ny - 1); ++b) {
        for (int a = max(x - 1, 0); a <= min(x + 1, nx - 1); ++a) {
            const float weight = (b == y ? 1 : 0.03125f) * (a == x ? 1 : 0.03125f);
            total += weight * view[(size_t)b * nx + a];
        }
    }
    return total;
}

__kernel void colours(__global float *restrict L, __global const float *restrict raw,
                      __global const float *restrict white, __global const float *restrict first,
                      __global const float *restrict second,
                      __global const float *restrict white_first,
                      __global const float *restrict white_second, const float least,
                      const int ny, const int nx, const int channel)
{
    const int y = get_global_id(1);
    const size_t view = row_start(get_global_id(2), 0, ny, nx);
    const float e = 0.001953125f;
    FOR_X(x, nx) {
        const size_t at = view + (size_t)y * nx + x;
        const float light = around(raw + view, y, x, ny, nx) + e * (first[at] + second[at]);
        const float flat = around(white + view, y, x, ny, nx) +
                           e * (white_first[at] + white_second[at]);
        L[at * 3 + channel] = light / fmax(flat, least);
    }
}
