/* Resampling of a raw lenslet image into the views of a light field.
 *
 *   L[v, u, i, k] = sum_ab h(a - y) h(b - x) raw[a, b],   (y, x) = row[i] + column[k] + down[v] + right[u]
 *
 * with h the cubic convolution kernel, a = -1/2 (Keys 1981, eq. 15), with -DLINEAR the triangle
 * 1 - |t|, or with -DSPLINE the cubic B-spline (Unser 1999), of which raw has the
 * coefficients; pixels off the sensor count 0.
 * Positions come as tables (y, x) = at + part, an integer and a fraction in [0, 1) that is a
 * multiple of 2^-24: except for B-splines, an integer position copies its pixel.
 *
 * Rows of lenslets are then interpolated to the requested columns: column k of row i lies
 * between its lenslets near_at[i % 2][k] and the next, at the fraction near_part[i % 2][k]; h again,
 * of B-splines that of Keys, and the last lenslet is repeated beyond the end of the row. Fraction 0 copies the lenslet.
 *
 * Mapping: FOR_X of common.cl over k; axis 1 = u; axis 2 = (v, i), so that items in a row read the
 * same lines of the sensor. Strides of L in samples define its memory order.
 * -DROWS: see common.cl.
 */
#include "common.cl"

/* Weights of the samples at -1, 0, 1, 2 for a position t in [0, 1]. */
inline float4 keys(float t)
{
#ifdef LINEAR
    return (float4)(0, 1 - t, t, 0);
#else
    return (float4)(((1.0f - 0.5f * t) * t - 0.5f) * t, (1.5f * t - 2.5f) * t * t + 1.0f,
                    ((2.0f - 1.5f * t) * t + 0.5f) * t, (0.5f * t - 0.5f) * t * t);
#endif
}

#ifdef SPLINE
inline float4 of_pixels(float t)
{
    const float s = 1 - t;
    return (float4)(s * s * s, (3.0f * t - 6.0f) * t * t + 4.0f, (3.0f * s - 6.0f) * s * s + 4.0f,
                    t * t * t) / 6.0f;
}
#else
#define of_pixels keys
#endif

/* Four pixels from p on of an axis of n: their weights, 0 off the sensor, and their indices.
 * (clamp with vectors: Oclgrind 21.10 computes the scalar form incorrectly.) */
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
    const float4 wy = on_sensor(of_pixels(part.s0), first.s0, ny, &y);
    const float4 wx = on_sensor(of_pixels(part.s1), first.s1, nx, &x);
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
                     __global const float2 *restrict right_part,
                     __global const int *restrict near_at,
                     __global const float *restrict near_part, const int ny, const int nx,
                     const int rows, const int lenslets, const int columns, const long stride_v,
                     const long stride_u, const long stride_y, const long stride_x)
{
    const int u = get_global_id(1);
    const int v = get_global_id(2) / rows;
    const int i = get_global_id(2) % rows;
    const int2 at = row_at[i] + down_at[v] + right_at[u];
    const float2 part = row_part[i] + down_part[v] + right_part[u];
    const int parity = (i & 1) * columns;
    L += v * stride_v + u * stride_u + i * stride_y;
    FOR_X(k, columns) {
        const int before = near_at[parity + k];
        const float between = near_part[parity + k];
        float value = 0;
        if (between != 0) {
            float weight[4];
            vstore4(keys(between), 0, weight);
            for (int m = 0; m < 4; ++m) {
                const int near = clamp(before + m - 1, 0, lenslets - 1);
                value += weight[m] * sample(raw, at + column_at[near], part + column_part[near],
                                            ny, nx);
            }
        } else {
            const int near = clamp(before, 0, lenslets - 1);
            value = sample(raw, at + column_at[near], part + column_part[near], ny, nx);
        }
        L[k * stride_x] = value;
    }
}
