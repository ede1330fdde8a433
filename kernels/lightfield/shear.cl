/* Shear, interpolate, sum: pictures refocused on many planes (Ng 2005, shift and add).
 *
 *   out[p, y, s] = sum_vu w[v, u] L[v, u](y + shift_y[p, v], s + channels shift_x[p, v, u]) / W
 *   W[p, y, s]   = sum of the weights of the samples in use
 *
 * s = x channels + c is a sample of a row, so colour only multiplies the shift along x. A
 * shift is an integer and a fraction b. Interpolation is linear, and separable because the shift is
 * constant for a view. With the view (v, u) moved by its integer shift,
 *
 *   R_v(s) = sum_u w (1 - b_u) L(s) + sum_u w b_u L(s + channels)       along x first,
 *   out(y) = sum_v (1 - b_v) R_v(y) + b_v R_v(y + 1)                    then along y.
 *
 * Views on a grid have shift_x[p, u]; scattered ones are V U rows of one view each.
 *
 * Samples outside a view are 0 and do not count in W.
 *
 * Tables (P planes of one launch, U views in a row, of which count[v] have a weight):
 *   order[v, k]      u of the k-th view with a weight
 *   span[v, k]       (first sample, number of further samples) of that view used by the planes
 *   slide[v, p, k]   samples from the first one to that of plane p
 *   taps[v, p, k]    (w (1 - b_u), w b_u)
 *   down[v, p], blend[v, p]   integer shift along y, and b_v
 *   norm[p, v, i]    W without the shifts along y, for each v; then their sum over v. Of sample s at
 *                    i = norm_column(s): samples inside all views are equal, and stored HELD times
 *
 * shear_blocks    one item = (width - channels) samples of `height` rows of all planes; for CPUs.
 *                 A row of views is copied to local memory once, as float and with its edges, and
 *                 then read for every plane; each sample is read once for both taps.
 * shear_samples   one item = one sample of HEIGHT rows of PLANES planes; for GPUs. With -DGROUP=n
 *                 its n neighbours first copy their part of a view to local memory.
 *
 * -DSAMPLE=uchar | ushort | half | float   storage type of the light field
 * -DLANES=4 | 8 | 16, -DVECTORS=n   shear_blocks: vector type, and vectors summed in registers
 * -DAHEAD                          shear_blocks: prefetch, if the compiler supports it
 * -DDIRECT                         shear_blocks: one plane, whose views are read once, in place
 * -DCHANNELS=1 | 3                  shear_blocks: number of channels, if 1 or 3
 * -DHEIGHT=n, -DPLANES=n, -DGROUP=n  shear_samples
 */
#include "common.cl"
#include "stored.cl"
#include "shear_norm.cl"

#ifdef LANES
#include "shear_rows.cl"

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void shear_blocks(__global float *restrict out, __global const SAMPLE *restrict L,
                           __global const int *restrict count, __global const int *restrict order,
                           __global const int2 *restrict span, __global const int *restrict slide,
                           __global const float2 *restrict taps, __global const int *restrict down,
                           __global const float *restrict blend, __global const float *restrict norm,
                           const int V, const int U, const int ny, const int samples,
                           const int channels, const int planes, const int plane0,
                           const int norm_pitch, const int near, const int far,
                           const int total, const int height, const int width, const int pitch,
                           __local float *views, __local float *sums, __local float *second)
{
    const int s0 = get_global_id(0) * (width - channels);
    const int y0 = get_global_id(1) * height;
    const int rows = min(height, ny - y0);
    for (int i = 0; i < planes * height * width; i += LANES)
        store(sums + i, (vec)(0.0f));
    for (int i = 0; i < max(channels, LANES); ++i)
        second[width + i] = 0.0f;  /* right of the block: summed, but not part of the picture */

    for (int v = 0; v < V; ++v) {
        const int n = count[v];
        int top = INT_MAX, bottom = INT_MIN;
        for (int p = 0; p < planes; ++p) {
            top = min(top, down[v * planes + p]);
            bottom = max(bottom, down[v * planes + p]);
        }
        top = max(top, -y0);
        bottom = min(bottom, ny - 1 - y0 - rows);
#ifdef DIRECT
        /* The block's samples [begin, end) lie inside all views; `begin` at a whole vector. */
        int begin = 0, end = min(width, samples - s0);
        for (int k = 0; k < n; ++k) {
            begin = max(begin, -(s0 + span[v * U + k].x));
            end = min(end, samples - channels - (s0 + span[v * U + k].x));
        }
        begin = (begin + LANES - 1) / LANES * LANES;
        top = max(top, down[v]);
        for (int t = top; n > 0 && t <= bottom + rows; ++t) {
            const int y = clamp(y0 + t, 0, ny - 1);
            const int r = t - down[v];
            const int ahead = y + 1 < ny ? samples : 0;
            __global const SAMPLE *row = L + row_start(v * U, y, ny, samples);
            __local float *upper = sums + (r - 1) * width, *lower = sums + r * width;
            const size_t view = (size_t)ny * samples;
            int step;
            for (int i = 0; i < min(width, samples - s0); i += step) {
                __local float *above = r > 0 ? upper + i : 0, *below = r < rows ? lower + i : 0;
                const bool many = i >= begin && i + CHUNK <= end;
                const bool few = i >= begin && i + FEW * LANES <= end;
                step = many ? CHUNK : few ? FEW * LANES : LANES;
                if (many)
                    sum_many(above, below, row + s0 + i, n, view, ahead, channels, order + v * U,
                             span + v * U, taps + v * U, blend[v]);
                else if (few)
                    sum_few(above, below, row + s0 + i, n, view, ahead, channels, order + v * U,
                            span + v * U, taps + v * U, blend[v]);
                else
                    sum_edge(above, below, row, views, n, view, s0 + i, samples, channels,
                             order + v * U, span + v * U, taps + v * U, blend[v]);
            }
        }
#else
        for (int t = top; n > 0 && t <= bottom + rows; ++t) {
            const int y = clamp(y0 + t, 0, ny - 1);
            for (int k = 0; k < n; ++k) {
                const int u = order[v * U + k];
                copy_row(views + k * pitch, L + row_start(v * U + u, y, ny, samples),
                         s0 + span[v * U + k].x, width + span[v * U + k].y, samples);
            }
            /* Prefetch the next row while this row is summed, some views per plane. */
#ifdef AHEAD
            const int next = t < bottom + rows ? clamp(y0 + t + 1, 0, ny - 1) : y;
#endif
            for (int p = 0; p < planes; ++p) {
#ifdef AHEAD
                for (int k = p * n / planes; k < (p + 1) * n / planes && next != y; ++k)
                    fetch_row(L + row_start(v * U + order[v * U + k], next, ny, samples) + s0
                              + span[v * U + k].x, width + span[v * U + k].y);
#endif
                const int r = t - down[v * planes + p];
                if (r < 0 || r > rows)
                    continue;
                __local float *row = sums + (p * height + r) * width;
                const int table = (v * planes + p) * U;
                for (int i = width - CHUNK; i >= 0; i -= CHUNK)
                    sum_chunk(r > 0 ? row - width + i : 0, r < rows ? row + i : 0, views + i,
                              second + i, n, pitch, channels, slide + table, taps + table,
                              blend[v * planes + p]);
            }
        }
#endif
    }

    const int n = min(width - channels, samples - s0);
    for (int p = 0; p < planes; ++p)
        for (int r = 0; r < rows; ++r) {
            __local float *from = sums + (p * height + r) * width;
            if (!total)
                divide_row(from, norm + (size_t)p * (V + 1) * norm_pitch, norm_pitch, near, far,
                           down + p, blend + p, V, planes, y0 + r, ny, s0, width);
            __global float *to = out + row_start(plane0 + p, y0 + r, ny, samples) + s0;
            for (int i = 0; i < n; ++i)
                to[i] = from[i];
        }
}
#endif

#ifdef HEIGHT
/* Sample s of a row of a view, which may lie outside. */
static float tap(__global const SAMPLE *row, const int s, const int samples)
{
    return s >= 0 && s < samples ? stored(row, s) : 0.0f;
}

#ifdef GROUP
/* Copy a work-group's part of one view for its planes, all items together. */
static void copy_tile(__local float *tile, __global const SAMPLE *view, const int top,
                      const int rows, const int first, const int wide, const int pitch,
                      const int ny, const int samples)
{
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int i = get_local_id(0); i < rows * wide; i += GROUP)
        tile[i / wide * pitch + i % wide] = tap(view + (size_t)clamp(top + i / wide, 0, ny - 1)
                                                * samples, first + i % wide, samples);
    barrier(CLK_LOCAL_MEM_FENCE);
}
#endif

__kernel void shear_samples(__global float *restrict out, __global const SAMPLE *restrict L,
                            __global const int *restrict count, __global const int *restrict order,
                            __global const int2 *restrict span, __global const int *restrict slide,
                            __global const float2 *restrict taps, __global const int *restrict down,
                            __global const float *restrict blend,
                            __global const float *restrict norm, const int V, const int U,
                            const int ny, const int samples, const int channels, const int planes,
                            const int plane0, const int norm_pitch, const int near,
                            const int far, const int total, const int pitch,
                            __local float *tile)
{
    const int s = get_global_id(0);
    const int p0 = get_global_id(1) * PLANES;
    const int y0 = get_global_id(2) * HEIGHT;
#ifndef GROUP
    if (s >= samples)
        return;
#endif
    float sums[PLANES][HEIGHT];
    for (int q = 0; q < PLANES; ++q)
        for (int r = 0; r < HEIGHT; ++r)
            sums[q][r] = 0.0f;

    for (int v = 0; v < V; ++v) {
        int at[PLANES], top[PLANES], highest = INT_MAX, lowest = INT_MIN;
        float row[PLANES][HEIGHT + 1];
        for (int q = 0; q < PLANES; ++q) {
            at[q] = v * planes + min(p0 + q, planes - 1);
            top[q] = y0 + down[at[q]];
            highest = min(highest, top[q]);
            lowest = max(lowest, top[q]);
            for (int r = 0; r <= HEIGHT; ++r)
                row[q][r] = 0.0f;
        }
        for (int k = 0; k < count[v]; ++k) {
            const int first = s + span[v * U + k].x;
            __global const SAMPLE *view = L + row_start(v * U + order[v * U + k], 0, ny, samples);
#ifdef GROUP
            int left = INT_MAX, right = INT_MIN;
            for (int q = 0; q < PLANES; ++q) {
                left = min(left, slide[at[q] * U + k]);
                right = max(right, slide[at[q] * U + k]);
            }
            copy_tile(tile, view, highest, lowest - highest + HEIGHT + 1,
                      first - (int)get_local_id(0) + left, right - left + GROUP + channels, pitch,
                      ny, samples);
#endif
            for (int q = 0; q < PLANES; ++q) {
                const float2 w = taps[at[q] * U + k];
#ifdef GROUP
                __local const float *from = tile + (top[q] - highest) * pitch
                                            + (int)get_local_id(0) + slide[at[q] * U + k] - left;
                for (int r = 0; r <= HEIGHT; ++r)
                    row[q][r] += w.x * from[r * pitch] + w.y * from[r * pitch + channels];
#else
                const int from = first + slide[at[q] * U + k];
                for (int r = 0; r <= HEIGHT; ++r) {
                    __global const SAMPLE *line =
                        view + (size_t)clamp(top[q] + r, 0, ny - 1) * samples;
                    row[q][r] += w.x * tap(line, from, samples)
                                 + w.y * tap(line, from + channels, samples);
                }
#endif
            }
        }
        for (int q = 0; q < PLANES; ++q) {
            const float b = blend[at[q]];
            for (int r = 0; r <= HEIGHT; ++r)
                row[q][r] = top[q] + r >= 0 && top[q] + r < ny ? row[q][r] : 0.0f;
            for (int r = 0; r < HEIGHT; ++r)
                sums[q][r] += (1.0f - b) * row[q][r] + b * row[q][r + 1];
        }
    }

#ifdef GROUP
    if (s >= samples)
        return;
#endif
    for (int p = p0; p < min(p0 + PLANES, planes); ++p)
        for (int r = 0; r < min(HEIGHT, ny - y0); ++r) {
            const int y = y0 + r;
            float value = sums[p - p0][r];
            if (!total) {
                __global const float *used = norm + (size_t)p * (V + 1) * norm_pitch
                                             + norm_column(s, near, far);
                float weight = 0.0f;
                if (all_inside(y, down + p, blend + p, V, planes, ny))
                    weight = used[V * norm_pitch];
                else
                    for (int v = 0; v < V; ++v)
                        weight += used[v * norm_pitch]
                                  * row_weight(y, down[v * planes + p], blend[v * planes + p], ny);
                value = weight != 0.0f ? value / weight : 0.0f;
            }
            out[row_start(plane0 + p, y, ny, samples) + s] = value;
        }
}
#endif
