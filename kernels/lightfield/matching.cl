/* Costs of every plane: mismatch of the views with the centre, robust to occlusions.
 *
 *   match        e_k = min(sum_c |L_k(y + at_y, x + at_x) - C|, tau)
 *                m_j = mean of e_k over the views of group j that see the point
 *                cost[p, y, x] = min(m_0, ratio min_j m_j + margin),    m_0 over all views
 *
 * C is the mean of the reference views around the middle of the aperture, on the same
 * plane. Views are sorted by their groups: the views first[i] .. first[i + 1] - 1
 * belong to group j with the share pattern[i, j]. A group of which less than half sees the point
 * is ignored. Tables of a launch: at[p, k] integer shifts (y, x); part[p, k] four taps along y
 * and four along x, from -1 on, which interpolate and scale; reach[p, k] 1 where the shift has a
 * fraction, along y and x.
 *
 * match: an item is MATCH_BLOCK pixels of a row on one plane; skipped where the plane
 * is outside the span (spans.cl).
 * -DSAMPLE=uchar | ushort | half | float   storage type of the light field
 * -DCHANNELS=n, -DMATCH_BLOCK=n
 */
#include "common.cl"
#include "spans.cl"
#include "stored.cl"

#define GROUPS 9

/* n pixels from x0 on of a view moved by `at`, clamped at its edges. */
inline void sheared(float *value, float *column, __global const SAMPLE *view, const int y,
                    const int x0, const int2 at, const float4 down, const float4 across,
                    const int n, const int ny, const int nx)
{
    const int samples = nx * CHANNELS;
    __global const SAMPLE *rows[4];
    for (int t = 0; t < 4; ++t)
        rows[t] = view + (size_t)clamp(y + at.x + t - 1, 0, ny - 1) * samples;
    const int first = x0 + at.y - 1;
    const int wide = n + 3;
    if (first >= 0 && first + wide <= nx) {
        const int from = first * CHANNELS;
        for (int i = 0; i < wide * CHANNELS; ++i)
            column[i] = down.x * stored(rows[0], from + i) + down.y * stored(rows[1], from + i)
                        + down.z * stored(rows[2], from + i) + down.w * stored(rows[3], from + i);
    } else {
        for (int x = 0; x < wide; ++x) {
            const int from = clamp(first + x, 0, nx - 1) * CHANNELS;
            for (int c = 0; c < CHANNELS; ++c)
                column[x * CHANNELS + c] = down.x * stored(rows[0], from + c)
                                           + down.y * stored(rows[1], from + c)
                                           + down.z * stored(rows[2], from + c)
                                           + down.w * stored(rows[3], from + c);
        }
    }
    for (int i = 0; i < n * CHANNELS; ++i)
        value[i] = across.x * column[i] + across.y * column[i + CHANNELS]
                   + across.z * column[i + 2 * CHANNELS] + across.w * column[i + 3 * CHANNELS];
}

#if MATCH_BLOCK > 1
__attribute__((reqd_work_group_size(1, 1, 1)))
#endif
__kernel void match(__global float *restrict out, __global const SAMPLE *restrict L,
                    __global const int2 *restrict spans, __global const int *restrict view,
                    __global const int2 *restrict at,
                    __global const float4 *restrict part, __global const int2 *restrict reach,
                    __global const int *restrict first, __global const float *restrict pattern,
                    const int patterns, __global const int *restrict reference,
                    __global const float *restrict share, const int references, const int views,
                    const int ny, const int nx, const float tau, const float ratio,
                    const float margin)
{
    const int x0 = get_global_id(0) * MATCH_BLOCK, y = get_global_id(1), p = get_global_id(2);
    if (x0 >= nx)
        return;
    const int n = min(MATCH_BLOCK, nx - x0);
    int any = 0;
    for (int x = x0 & ~15; x < x0 + n; x += 16)
        any |= in_span(spans, y, x, p, nx);
    if (!any)
        return;
    const size_t size = (size_t)ny * nx * CHANNELS;
    float centre[MATCH_BLOCK * CHANNELS], value[MATCH_BLOCK * CHANNELS];
    float column[(MATCH_BLOCK + 3) * CHANNELS];
    float sums[GROUPS * MATCH_BLOCK], seen[GROUPS * MATCH_BLOCK];
    float part_sum[MATCH_BLOCK], part_seen[MATCH_BLOCK];
    float most[GROUPS];

    for (int i = 0; i < n * CHANNELS; ++i)
        centre[i] = 0;
    for (int r = 0; r < references; ++r) {
        const int k = p * views + reference[r];
        sheared(value, column, L + view[reference[r]] * size, y, x0, at[k], part[2 * k],
                part[2 * k + 1], n, ny, nx);
        for (int i = 0; i < n * CHANNELS; ++i)
            centre[i] += share[r] * value[i];
    }
    for (int i = 0; i < GROUPS * MATCH_BLOCK; ++i)
        sums[i] = seen[i] = 0;
    for (int j = 0; j < GROUPS; ++j)
        most[j] = 0;

    for (int g = 0; g < patterns; ++g) {
        for (int x = 0; x < n; ++x)
            part_sum[x] = part_seen[x] = 0;
        for (int v = first[g]; v < first[g + 1]; ++v) {
            const int k = p * views + v;
            const int row = y + at[k].x;
            const int begin = clamp(-at[k].y - x0, 0, n);
            const int end = clamp(nx - at[k].y - reach[k].y - x0, begin, n);
            if (row < 0 || row + reach[k].x >= ny || begin == end)
                continue;
            sheared(value, column, L + view[v] * size, y, x0, at[k], part[2 * k],
                    part[2 * k + 1], n, ny, nx);
            for (int x = begin; x < end; ++x) {
                float e = 0;
                for (int c = 0; c < CHANNELS; ++c)
                    e += fabs(value[x * CHANNELS + c] - centre[x * CHANNELS + c]);
                part_sum[x] += fmin(e, tau);
                part_seen[x] += 1;
            }
        }
        for (int j = 0; j < GROUPS; ++j) {
            const float w = pattern[g * GROUPS + j];
            most[j] += w * (first[g + 1] - first[g]);
            if (w != 0)
                for (int x = 0; x < n; ++x) {
                    sums[j * MATCH_BLOCK + x] += w * part_sum[x];
                    seen[j * MATCH_BLOCK + x] += w * part_seen[x];
                }
        }
    }

    out += row_start(p, y, ny, nx) + x0;
    for (int x = 0; x < n; ++x) {
        float least = seen[x] > 0 ? sums[x] / seen[x] : tau;
        for (int j = 1; j < GROUPS; ++j) {
            const float count = seen[j * MATCH_BLOCK + x];
            if (count > 0 && count >= 0.5f * most[j])
                least = fmin(least, ratio * sums[j * MATCH_BLOCK + x] / count + margin);
        }
        out[x] = least;
    }
}
