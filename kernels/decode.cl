/* Resampling of a raw lenslet image into the views of a light field.
 *
 *   L[v, u, i, k] = sum_ab h(a - y) h(b - x) raw[a, b],   (y, x) = row[i] + column[k] + down[v] + right[u]
 *
 * with h the cubic convolution kernel, a = -1/2 (Keys 1981, eq. 15); pixels off the sensor count 0.
 * Positions come as tables (y, x) = at + part, an integer and a fraction in [0, 1) that is a
 * multiple of 2^-24: a whole position takes its pixel as it is.
 *
 * An odd row of a hexagonal lattice is then interpolated to the columns of the even rows: column k
 * lies between its samples k + before and k + before + 1, at the fraction `between`; h again, and
 * the last sample stands for those beyond the end of the row. An even row has before = between = 0.
 *
 * Mapping: FOR_X of common.cl over k; axis 1 = u; axis 2 = (v, i), so that items in a row read the
 * same lines of the sensor. -DROWS: see common.cl.
 */
#include "common.cl"

/* Weights of the samples at -1, 0, 1, 2 for a position t in [0, 1]. */
inline float4 keys(float t)
{
    return (float4)(((1.0f - 0.5f * t) * t - 0.5f) * t, (1.5f * t - 2.5f) * t * t + 1.0f,
                    ((2.0f - 1.5f * t) * t + 0.5f) * t, (0.5f * t - 0.5f) * t * t);
}

/* Four pixels from p on of an axis of n: their weights, 0 off the sensor, and their indices.
 * (clamp with vectors: Oclgrind 21.10 gets the form with scalars wrong.) */
inline float4 on_sensor(float4 weight, int p, int n, int4 *index)
{
    const int4 pixel = p + (int4)(0, 1, 2, 3);
    *index = clamp(pixel, (int4)(0), (int4)(n - 1));
    return select((float4)(0), weight, pixel == *index);
}

inline float along(__global const float *restrict line, int4 x, float4 w)
{
    return w.s0 * line[x.s0] + w.s1 * line[x.s1] + w.s2 * line[x.s2] + w.s3 * line[x.s3];
}

/* raw at (y, x) = at + part, part in [0, 4). */
inline float sample(__global const float *restrict raw, int2 at, float2 part, int ny, int nx)
{
    const int2 carry = convert_int2(part);
    const int2 first = at + carry - 1;
    part -= convert_float2(carry);
    int4 y, x;
    const float4 wy = on_sensor(keys(part.s0), first.s0, ny, &y);
    const float4 wx = on_sensor(keys(part.s1), first.s1, nx, &x);
    return wy.s0 * along(raw + (size_t)y.s0 * nx, x, wx) +
           wy.s1 * along(raw + (size_t)y.s1 * nx, x, wx) +
           wy.s2 * along(raw + (size_t)y.s2 * nx, x, wx) +
           wy.s3 * along(raw + (size_t)y.s3 * nx, x, wx);
}

__kernel void decode(__global float *restrict L, __global const float *restrict raw,
                     __global const int2 *restrict row_at, __global const float2 *restrict row_part,
                     __global const int2 *restrict column_at,
                     __global const float2 *restrict column_part,
                     __global const int2 *restrict down_at,
                     __global const float2 *restrict down_part,
                     __global const int2 *restrict right_at,
                     __global const float2 *restrict right_part, const int ny, const int nx,
                     const int U, const int rows, const int columns, const int before,
                     const float between)
{
    const int u = get_global_id(1);
    const int v = get_global_id(2) / rows;
    const int i = get_global_id(2) % rows;
    const bool moved = (i & 1) && (before != 0 || between != 0);
    const int2 at = row_at[i] + down_at[v] + right_at[u];
    const float2 part = row_part[i] + down_part[v] + right_part[u];
    const size_t out = row_start(v * U + u, i, rows, columns);
    float weight[4];
    vstore4(keys(between), 0, weight);
    FOR_X(k, columns) {
        float value = 0;
        if (moved) {
            for (int m = 0; m < 4; ++m) {
                const int near = clamp(k + before + m - 1, 0, columns - 1);
                value += weight[m] * sample(raw, at + column_at[near], part + column_part[near],
                                            ny, nx);
            }
        } else {
            value = sample(raw, at + column_at[k], part + column_part[k], ny, nx);
        }
        L[out + k] = value;
    }
}
