/* Simple reductions and slices of the samples of a light field.
 *
 *   lit        lit[view] = 1 if a sample of the view is not 0, else 0; one item a view
 *   extremes   out[row] = smallest and largest sample of a row; one item a row
 *   brightness   out[row] = sum of the samples of a row; one item a row
 *   slice      out[r, k, c] = L[start + r row_step + k column_step + c], as float32; FOR_X over (k, c)
 *
 * -DSAMPLE=uchar | ushort | half | float: storage type of the light field. -DROWS: see common.cl.
 */
#include "common.cl"
#include "stored.cl"

__kernel void lit(__global int *restrict lit, __global const SAMPLE *restrict L, const int views,
                  const long samples)
{
    const int view = get_global_id(0);
    if (view >= views)
        return;
    __global const SAMPLE *from = L + view * samples;
    long s = 0;
    while (s < samples && stored(from, s) == 0)
        ++s;
    lit[view] = s < samples;
}

__kernel void extremes(__global float2 *restrict out, __global const SAMPLE *restrict L,
                       const long rows, const int samples)
{
    const long row = get_global_id(0);
    if (row >= rows)
        return;
    __global const SAMPLE *from = L + row * samples;
    float low = stored(from, 0), high = low;
    for (int s = 1; s < samples; ++s) {
        low = fmin(low, stored(from, s));
        high = fmax(high, stored(from, s));
    }
    out[row] = (float2)(low, high);
}

__kernel void brightness(__global float *restrict out, __global const SAMPLE *restrict L,
                         const int rows, const int samples)
{
    const int row = get_global_id(0);
    if (row >= rows)
        return;
    __global const SAMPLE *from = L + (size_t)row * samples;
    float sum = 0;
    for (int i = 0; i < samples; ++i)
        sum += stored(from, i);
    out[row] = sum;
}

__kernel void slice(__global float *restrict out, __global const SAMPLE *restrict L,
                    const long start, const long row_step, const long column_step,
                    const int columns, const int channels)
{
    const int r = get_global_id(1);
    const int width = columns * channels;
    FOR_X(s, width)
        out[(long)r * width + s] =
            stored(L, start + r * row_step + s / channels * column_step + s % channels);
}
