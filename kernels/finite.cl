/* How many samples of each row are NaN or infinite.
 *
 *   bad[row] = #{x : not isfinite(a[row, x])}
 *
 * Mapping: one item a row. -DDOUBLE: float64 samples. Complex fields count as rows of 2 nx reals.
 */
#include "common.cl"

__kernel void count_bad(__global int *restrict bad, __global const real *restrict a, const int rows,
                        const int nx)
{
    const int row = get_global_id(0);
    if (row >= rows)
        return;
    const size_t start = (size_t)row * nx;
    int count = 0;
    for (int x = 0; x < nx; ++x)
        count += !isfinite(a[start + x]);
    bad[row] = count;
}
