/* Pictures of lenslets as fields on the lattice of lenslets, one for two samples of a lenslet.
 *
 *   C[b, r, l] = a[b, l w + m] + i a[b, l w + m'],   m = (r / wx, r % wx),  m' = w - 1 - m
 *
 * for the wy x wx samples m of lenslet l; r counts the pairs up to the middle sample, which is its
 * own mirror image if both are odd. A cell of several lenslets may replace a lenslet (cells.py).
 * decimate pads a window of (ny, nx) lattice points with zeros. Point l contains lenslet l + first;
 * with -DCENTRED it is l + first for l < (ny + 1)/2 and l - ny + first beyond, so that lenslet
 * `first` = (fy, fx) is at l = 0. interleave is the inverse for the first points of the window; no
 * sample is below `least`. From stacks of `all` pictures the planes start, start + 1, ... are used,
 * `planes` of each stack.
 *
 * -DCENTRED  see above
 * -DROWS     see common.cl
 * Mapping: FOR_X of common.cl over C, of interleave over the picture.
 */
#include "common.cl"

/* Index of a picture in the stacks. */
inline int picture(int b, int planes, int start, int all)
{
    return b / planes * all + start + b % planes;
}

/* Index of the lenslet at a lattice point. */
inline int lenslet(int l, int n, int first)
{
#ifdef CENTRED
    return (l < (n + 1) / 2 ? l : l - n) + first;
#else
    return l + first;
#endif
}

__kernel void decimate(__global float2 *restrict C, __global const float *restrict a, const int wy,
                       const int wx, const int fy, const int fx, const int planes, const int start,
                       const int all, const int rows, const int columns, const int ny,
                       const int nx)
{
    const int y = get_global_id(1), batch = get_global_id(2), pairs = (wy * wx + 1) / 2;
    const int b = picture(batch / pairs, planes, start, all);
    const int r = batch % pairs, my = r / wx, mx = r % wx;
    const int ly = lenslet(y, ny, fy);
    const size_t to = row_start(batch, y, ny, nx);
    const size_t width = (size_t)columns * wx;
    if (ly < 0 || ly >= rows) {
        FOR_X(x, nx)
            C[to + x] = (float2)(0, 0);
        return;
    }
    __global const float *cells = a + ((size_t)b * rows + ly) * wy * width;
    __global const float *one = cells + my * width + mx;
    __global const float *other = cells + (wy - 1 - my) * width + wx - 1 - mx;
    FOR_X(x, nx) {
        const int lx = lenslet(x, nx, fx);
        const bool inside = lx >= 0 && lx < columns;
        C[to + x] = inside ? (float2)(one[lx * wx], other[lx * wx]) : (float2)(0, 0);
    }
}

__kernel void interleave(__global float *restrict a, __global const float2 *restrict C,
                         const int wy, const int wx, const float least, const int planes,
                         const int start, const int all, const int rows, const int columns,
                         const int ny, const int nx)
{
    const int y = get_global_id(1), b = get_global_id(2), pairs = (wy * wx + 1) / 2;
    const int ly = y / wy, my = y % wy;
    const size_t to = row_start(picture(b, planes, start, all), y, rows * wy, columns * wx);
#ifdef ROWS
    for (int mx = 0; mx < wx; ++mx) { /* avoids a division for each sample */
        const int m = my * wx + mx, r = min(m, wy * wx - 1 - m);
        __global const float2 *from = C + row_start(b * pairs + r, ly, ny, nx);
        __global float *out = a + to + mx;
        if (m == r) {
            for (int lx = 0; lx < columns; ++lx)
                out[lx * wx] = fmax(from[lx].x, least);
        } else {
            for (int lx = 0; lx < columns; ++lx)
                out[lx * wx] = fmax(from[lx].y, least);
        }
    }
#else
    FOR_X(x, columns * wx) {
        const int lx = x / wx, m = my * wx + x % wx;
        const int r = min(m, wy * wx - 1 - m);
        const float2 c = C[row_start(b * pairs + r, ly, ny, nx) + lx];
        a[to + x] = fmax(m == r ? c.x : c.y, least);
    }
#endif
}
