/* Moments of a gradient over the samples of each lenslet.
 *
 *   m[lenslet, (i, k)] = sum of Im(G) b^i a^k, i + k <= ORDER, over samples with this nearest lenslet
 *
 * (b, a): offset of the sample from the lenslet's centre, in pitches along the rows' normal and along
 * the rows. G is that of the field behind an element (transmission_gradient.cl); Im(G) is then the
 * gradient by the phase. Pairs (i, k) are ordered by i, then k. boxes, parts, out: see
 * lenslet_sums.cl.
 *
 * -DORDER=n       the highest power
 * -DHEXAGONAL     see nearest_lenslet.cl
 * -DDOUBLE        see common.cl
 *
 * Mapping: one item per part of a lenslet, axis 0.
 */
#include "nearest_lenslet.cl"
#define SUMS ((ORDER + 1) * (ORDER + 2) / 2)
#include "lenslet_sums.cl"

__kernel void lenslet_moments(__global real *restrict out, __global const cplx *restrict G,
                              __global const real2 *restrict a_of_y,
                              __global const real2 *restrict b_of_y,
                              __global const real2 *restrict a_of_x,
                              __global const real2 *restrict b_of_x,
                              __global const int4 *restrict boxes, const int parts, const int rows,
                              const int columns, const int nx)
{
    const int item = get_global_id(0);
    if (item >= rows * columns * parts)
        return;
    const int4 box = boxes[item / parts];
    const int mine = item / parts;
    real total[SUMS], lost[SUMS], line[SUMS];
    for (int k = 0; k < SUMS; ++k)
        total[k] = lost[k] = 0;
    for (int y = box.x + item % parts; y < box.y; y += parts) {
        for (int k = 0; k < SUMS; ++k)
            line[k] = 0;
        for (int x = box.z; x < box.w; ++x) {
            const Lenslet l = nearest(a_of_y[y] + a_of_x[x], b_of_y[y] + b_of_x[x], rows, columns);
            if (l.row * columns + l.column != mine)
                continue;
            real down = G[row_start(0, y, 0, nx) + x].y;
            int n = 0;
            for (int i = 0; i <= ORDER; ++i) {
                real value = down;
                for (int k = 0; k <= ORDER - i; ++k) {
                    line[n++] += value;
                    value *= l.a;
                }
                down *= l.b;
            }
        }
        add_line(total, lost, line);
    }
    for (int k = 0; k < SUMS; ++k)
        out[(size_t)item * SUMS + k] = total[k];
}
