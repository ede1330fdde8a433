/* Mean and variance over the views of a light field sheared by planes.
 *
 *   l_n(y, s)        = value of view n, moved by the plane's constant (sheared.cl), c_n its share inside
 *   mean[p, y, s]    = sum_n w_n c_n l_n / W,   W = sum_n w_n c_n
 *   variance[p, y, s] = sum_n w_n c_n (l_n - mean)^2 / W = S2 - S1^2
 *
 * S1 and S2 are moments about the sample of one view near the middle, which takes away most of what
 * S2 - S1^2 would lose by cancellation. A variance below (1e-5 mean)^2 is rounding and counts 0, as
 * where no view has a weight.
 *
 * place[p, n] = (view, whole shift along y, along x, 0);  part[p, n] = (their fractions, w_n, 0).
 * Mapping: an item = LANES VECTORS samples of a row of one plane, in the order of sheared.cl.
 * -DSAMPLE=uchar | ushort | float, -DLANES=1 | 4 | 8 | 16, -DVECTORS=n: see sheared.cl.
 */
#include "sheared.cl"

#define ROUNDING 1e-10f

__kernel void moments(__global float *restrict mean, __global float *restrict variance,
                      __global const SAMPLE *restrict L, __global const int4 *restrict place,
                      __global const float4 *restrict part, const int views, const int middle,
                      __global const int2 *restrict edge, const int reach, const int ny,
                      const int nx, const int channels)
{
    const view_size size = {ny, nx, channels, nx * channels, edge + reach};
    const int p = get_global_id(1 - SAMPLE_AXIS), y = get_global_id(2);
    const int s = get_global_id(SAMPLE_AXIS) * LANES * VECTORS;
    if (s >= size.n)
        return;
    const view_rows centre = moved(L, (int4)(middle, 0, 0, 0), (float4)(0.0f), y, size);
    vec pivot[VECTORS], W[VECTORS], S1[VECTORS], S2[VECTORS];
    EACH_VECTOR(j) {
        pivot[j] = value(centre, s + LANES * j, size);
        W[j] = S1[j] = S2[j] = (vec)(0.0f);
    }
    for (int n = p * views; n < (p + 1) * views; ++n) {
        const view_rows rows = moved(L, place[n], part[n], y, size);
        const float share = part[n].z * rows.share;
        if (within(rows, s, LANES * VECTORS, size)) {
            EACH_VECTOR(j) {
                const vec l = value_within(rows, s + LANES * j, size) - pivot[j];
                W[j] += share;
                S1[j] += share * l;
                S2[j] += share * l * l;
            }
        } else {
            for (int j = 0; j < VECTORS; ++j) {
                const vec l = value(rows, s + LANES * j, size) - pivot[j];
                const vec w = part[n].z * inside(rows, s + LANES * j, size);
                W[j] += w;
                S1[j] += w * l;
                S2[j] += w * l * l;
            }
        }
    }
    const size_t row = row_start(p, y, ny, size.n);
    EACH_VECTOR(j) {
        const vec some = W[j] > 0.0f ? W[j] : (vec)(1.0f);
        const vec m = S1[j] / some;
        const vec v = S2[j] / some - m * m;
        const vec whole = W[j] > 0.0f ? m + pivot[j] : (vec)(0.0f);
        store_row(mean + row, whole, s + LANES * j, size.n);
        store_row(variance + row, v > ROUNDING * whole * whole ? v : (vec)(0.0f), s + LANES * j,
                  size.n);
    }
}
