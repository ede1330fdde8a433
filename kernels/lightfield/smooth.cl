/* Smoothing of maps (p, y, x) by a symmetric window, along both axes in one pass.
 *
 *   out[start + p, y, x] = sum_s sum_t w[|s|] w[|t|] in[p, y + s, x + t],   -radius <= s, t <= radius
 *
 * Beyond the edges the map is reflected.
 * Mapping: a group of items owns `length` samples of LINES rows (separated.cl), axis 1 = y / LINES,
 * axis 2 = p. -DLINES=n, -DLANES=4 | 8 | 16; -DROWS: the group is one item.
 */
#include "separated.cl"

__kernel void smooth(__global float *restrict out, __global const float *restrict in,
                     __global const float *restrict w, const int radius, const int start,
                     const int ny, const int nx, const int length, __local float *line)
{
    const int y = get_global_id(1) * LINES, p = get_global_id(2);
    const int first = get_group_id(0) * length;
    const int count = min(length, nx - first), apart = length + 2 * radius;
    w += radius + LINES - 1;
    columns(line, apart, in + row_start(p, 0, ny, nx), y, first, count, radius, w, radius, ny, nx, 1);
    barrier(CLK_LOCAL_MEM_FENCE);
    out += row_start(start + p, y, ny, nx) + first;
    line += radius;
    for (int r = 0; r < min(LINES, ny - y); ++r, out += nx, line += apart) {
#ifdef ROWS
        vec sum[VECTORS];
        FOR_CHUNKS(i, 0, count, CHUNK) {
            across_chunk(sum, line + i, w, radius, 1);
            UNROLLED(j)
                store(out + i + LANES * j, sum[j]);
        }
        if (count >= CHUNK)
            continue;
#endif
        FOR_ITEMS(i, count)
            out[i] = across(line + i, w, radius, 1);
    }
}
