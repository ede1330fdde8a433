/* Resampling of a raw lenslet image whose lattice is aligned with the sensor, axis by axis.
 *
 *   line[x]       = sum_m down[m][v rows + i] raw[above[v rows + i] + m, x],             m = 0 ... 3
 *   L[v, u, i, k] = sum_m across[m][u columns + k] line[left[u columns + k] + m]
 *
 * The weights are computed on the host, 0 off the sensor. Strides of L in samples define its
 * memory order.
 *
 * Mapping: an item = row i of all views v, in one line of local memory with MARGIN zeros at either
 * end; axis 0 = v rows + i. For CPUs: both loops vectorise, and a line is read once for all u.
 */
#include "common.cl"

#define MARGIN 4

__kernel void decode_upright(__global float *restrict L, __global const float *restrict raw,
                             __global const int *restrict above, __global const float *restrict down,
                             __global const int *restrict left, __global const float *restrict across,
                             const int ny, const int nx, const int V, const int U, const int rows,
                             const int columns, const long stride_v, const long stride_u,
                             const long stride_y, const long stride_x, __local float *restrict line)
{
    const int j = get_global_id(0), count = V * rows, samples = U * columns;
    if (j >= count)
        return;
    const int top = above[j];
    __global const float *restrict a = raw + (size_t)clamp(top, 0, ny - 1) * nx;
    __global const float *restrict b = raw + (size_t)clamp(top + 1, 0, ny - 1) * nx;
    __global const float *restrict c = raw + (size_t)clamp(top + 2, 0, ny - 1) * nx;
    __global const float *restrict d = raw + (size_t)clamp(top + 3, 0, ny - 1) * nx;
    const float wa = down[j], wb = down[count + j], wc = down[2 * count + j];
    const float wd = down[3 * count + j];
    for (int x = 0; x < MARGIN; ++x)
        line[x] = line[MARGIN + nx + x] = 0;
    for (int x = 0; x < nx; ++x)
        line[MARGIN + x] = wa * a[x] + wb * b[x] + wc * c[x] + wd * d[x];
    L += j / rows * stride_v + j % rows * stride_y;
    for (int u = 0; u < U; ++u) {
        __global float *restrict to = L + u * stride_u;
        __global const int *restrict from = left + u * columns;
        __global const float *restrict w = across + u * columns;
        for (int k = 0; k < columns; ++k) {
            __local const float *at = line + from[k];
            to[k * stride_x] = w[k] * at[0] + w[samples + k] * at[1] + w[2 * samples + k] * at[2]
                               + w[3 * samples + k] * at[3];
        }
    }
}
