/* The adjoint of decode.cl and upright.cl: views are spread back to the raw image.
 *
 *   raw[a, b] = sum_vuik h(a - y) h(b - x) L[v, u, i, k],   (y, x) = row[i] + column[k] + down[v] + right[u]
 *
 * with h and the tables of decode.cl. Every pixel gathers in a fixed order, so results are bitwise
 * reproducible. Three kernels are products with a sparse matrix, whose row r has the entries start[r] to
 * start[r + 1] of (index, weight):
 *
 *   lenslets   M[v, u, i, m] = sum_t weight[t] L[v, u, i, index[t]], where rows of lenslets were
 *              interpolated to columns; one matrix for even rows of lenslets and one for odd ones
 *   across     line[j, b] = sum_t weight[t] L[j, index[t]],  j = (v, i): a lattice along the sensor
 *   upwards    raw[a, b]  = sum_t weight[t] line[index[t], b]
 *
 *   pixels     the equation above, for any lattice
 *
 * Mapping: FOR_X of common.cl over a row of the output; axis 1 = its rows; axis 2 = view (lenslets).
 * pixels with -DROWS: an item = `height` rows of the raw image, axis 0, to which it adds nearby samples,
 * lenslet by lenslet; the samples of a lenslet lie `tall` rows (from, to) from its first
 * view. Else an item = a pixel, axes 0 and 1: the contributing lenslets and views follow from bounds of
 * i, k, v and u, solved from (y, x) = (a, b).
 * -DLINEAR: the triangle instead of Keys' kernel; -DSPLINE: the cubic B-spline. -DROWS: see common.cl.
 */
#include "common.cl"

__kernel void lenslets(__global float *restrict M, __global const float *restrict L,
                       __global const int *restrict start, __global const int *restrict index,
                       __global const float *restrict weight, const int U, const int rows,
                       const int count, const long stride_v, const long stride_u,
                       const long stride_y, const long stride_x)
{
    const int i = get_global_id(1), view = get_global_id(2);
    L += view / U * stride_v + view % U * stride_u + i * stride_y;
    start += (i & 1) * (count + 1);
    const size_t at = row_start(view, i, rows, count);
    FOR_X(m, count) {
        float sum = 0;
        for (int t = start[m]; t < start[m + 1]; ++t)
            sum += weight[t] * L[index[t] * stride_x];
        M[at + m] = sum;
    }
}

__kernel void across(__global float *restrict line, __global const float *restrict L,
                     __global const int *restrict start, __global const long *restrict index,
                     __global const float *restrict weight, const int rows, const int nx,
                     const long stride_v, const long stride_y)
{
    const int j = get_global_id(1);
    L += j / rows * stride_v + j % rows * stride_y;
    const size_t at = (size_t)j * nx;
    FOR_X(b, nx) {
        float sum = 0;
        for (int t = start[b]; t < start[b + 1]; ++t)
            sum += weight[t] * L[index[t]];
        line[at + b] = sum;
    }
}

__kernel void upwards(__global float *restrict raw, __global const float *restrict line,
                      __global const int *restrict start, __global const int *restrict index,
                      __global const float *restrict weight, const int nx)
{
    const int a = get_global_id(1);
    const size_t at = (size_t)a * nx;
    FOR_X(b, nx) {
        raw[at + b] = 0;
    }
    for (int t = start[a]; t < start[a + 1]; ++t) {
        __global const float *from = line + (size_t)index[t] * nx;
        const float w = weight[t];
        FOR_X(b, nx) {
            raw[at + b] += w * from[b];
        }
    }
}

/* Weight of pixel m = 0 ... 3 of the four about a position between the second and the third. */
inline float weight_at(float t, int m)
{
#if defined LINEAR
    return m == 1 ? 1 - t : m == 2 ? t : 0;
#elif defined SPLINE
    const float s = 1 - t;
    return (m == 0 ? s * s * s
          : m == 1 ? (3.0f * t - 6.0f) * t * t + 4.0f
          : m == 2 ? (3.0f * s - 6.0f) * s * s + 4.0f
                   : t * t * t) / 6.0f;
#else
    return m == 0 ? ((1.0f - 0.5f * t) * t - 0.5f) * t
         : m == 1 ? (1.5f * t - 2.5f) * t * t + 1.0f
         : m == 2 ? ((2.0f - 1.5f * t) * t + 0.5f) * t
                  : (0.5f * t - 0.5f) * t * t;
#endif
}

#ifdef ROWS
/* value h(a - y) h(b - x) for the pixels from `at` on, some of which may lie outside. */
inline void add_taps(__global float *restrict raw, float value, int2 at, float2 part, int2 rows,
                     int nx)
{
    const float4 wx = (float4)(weight_at(part.s1, 0), weight_at(part.s1, 1), weight_at(part.s1, 2),
                               weight_at(part.s1, 3));
    const bool inside = at.s1 >= 0 && at.s1 + 3 < nx;
    for (int m = max(0, rows.s0 - at.s0); m < min(4, rows.s1 - at.s0); ++m) {
        __global float *to = raw + (size_t)(at.s0 + m) * nx;
        const float4 share = value * weight_at(part.s0, m) * wx;
        if (inside)
            vstore4(vload4(0, to + at.s1) + share, 0, to + at.s1);
        else {
            float alone[4];
            vstore4(share, 0, alone);
            for (int n = max(0, -at.s1); n < min(4, nx - at.s1); ++n)
                to[at.s1 + n] += alone[n];
        }
    }
}
#else
/* The weight that a sample at `at` + part, part in [0, 4), has for a pixel of an axis. */
inline float weight_of(int at, float part, int pixel)
{
    const int carry = (int)part, m = pixel - (at + carry - 1);
    return m < 0 || m > 3 ? 0.0f : weight_at(part - (float)carry, m);
}

/* First and last integer of [0, count) from place + low to place + high. */
inline int2 bounds(float place, float2 low_high, int count)
{
    const float first = ceil(place + low_high.x), last = floor(place + low_high.y);
    return (int2)((int)clamp(first, 0.0f, (float)count),
                  (int)clamp(last, -1.0f, (float)(count - 1)));
}

#endif

__kernel void pixels(__global float *restrict raw, __global const float *restrict L,
                     __global const int2 *restrict row_at, __global const float2 *restrict row_part,
                     __global const int2 *restrict column_at,
                     __global const float2 *restrict column_part,
                     __global const int2 *restrict down_at,
                     __global const float2 *restrict down_part,
                     __global const int2 *restrict right_at,
                     __global const float2 *restrict right_part, const float4 lattice,
                     const float4 reach, const float2 shift, const float4 views,
                     const float4 near_views, const float2 tall, const int height, const int ny,
                     const int nx, const int rows, const int count, const int V, const int U,
                     const long stride_v, const long stride_u, const long stride_y,
                     const long stride_x)
{
#ifdef ROWS
    const int top = get_global_id(0) * height;
    const int2 band = (int2)(top, min(top + height, ny));
    for (size_t j = (size_t)band.s0 * nx; j < (size_t)band.s1 * nx; ++j)
        raw[j] = 0;
    for (int i = 0; i < rows; ++i) {
        for (int k = 0; k < count; ++k) {
            const int2 at = row_at[i] + column_at[k];
            if (at.s0 + tall.s1 < band.s0 || at.s0 + tall.s0 >= band.s1)
                continue;
            for (int v = 0; v < V; ++v) {
                for (int u = 0; u < U; ++u) {
                    float2 part = row_part[i] + down_part[v] + right_part[u];
                    part += column_part[k];
                    const int2 carry = convert_int2(part);
                    const int2 first = at + down_at[v] + right_at[u] + carry - 1;
                    if (first.s0 + 3 >= band.s0 && first.s0 < band.s1)
                        add_taps(raw, L[v * stride_v + u * stride_u + i * stride_y + k * stride_x],
                                 first, part - convert_float2(carry), band, nx);
                }
            }
        }
    }
#else
    const int a = get_global_id(1);
    const int2 first_at = row_at[0] + column_at[0] + down_at[0] + right_at[0];
    const float2 first_part = row_part[0] + column_part[0] + down_part[0] + right_part[0];
    const int b = get_global_id(0);
    if (b < nx) {
        const float2 q = convert_float2((int2)(a, b) - first_at) - first_part;
        const int2 i_range = bounds(lattice.s0 * q.s0 + lattice.s1 * q.s1, reach.s01, rows);
        float sum = 0;
        for (int i = i_range.s0; i <= i_range.s1; ++i) {
            const float along = lattice.s2 * q.s0 + lattice.s3 * q.s1 - (i & 1 ? shift.s1 : shift.s0);
            const int2 k_range = bounds(along, reach.s23, count);
            for (int k = k_range.s0; k <= k_range.s1; ++k) {
                const int2 at = row_at[i] + column_at[k];
                const float2 p = convert_float2((int2)(a, b) - at - down_at[0] - right_at[0])
                                 - (row_part[i] + column_part[k] + down_part[0] + right_part[0]);
                const int2 v_range = bounds(views.s0 * p.s0 + views.s1 * p.s1, near_views.s01, V);
                const int2 u_range = bounds(views.s2 * p.s0 + views.s3 * p.s1, near_views.s23, U);
                for (int v = v_range.s0; v <= v_range.s1; ++v) {
                    for (int u = u_range.s0; u <= u_range.s1; ++u) {
                        const int2 place = at + down_at[v] + right_at[u];
                        float2 part = row_part[i] + down_part[v] + right_part[u];
                        part += column_part[k];
                        const float wy = weight_of(place.s0, part.s0, a);
                        if (wy != 0)
                            sum += wy * weight_of(place.s1, part.s1, b)
                                   * L[v * stride_v + u * stride_u + i * stride_y + k * stride_x];
                    }
                }
            }
        }
        raw[(size_t)a * nx + b] = sum;
    }
#endif
}
