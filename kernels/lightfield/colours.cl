/* Sum of maps over the colours.
 *
 *   out[p, y, x] = sum_c in[p, y, x, c]
 *
 * Mapping: FOR_X of common.cl. -DROWS.
 */
#include "common.cl"

__kernel void add_colours(__global float *restrict out, __global const float *restrict in,
                          const int ny, const int nx, const int channels)
{
    const size_t row = row_start(get_global_id(2), get_global_id(1), ny, nx);
    FOR_X(x, nx) {
        float sum = 0.0f;
        for (int c = 0; c < channels; ++c)
            sum += in[(row + x) * channels + c];
        out[row + x] = sum;
    }
}
