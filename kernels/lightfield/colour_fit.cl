/* Colours of the views of a mosaic, each fitted to the pixels of one lenslet.
 *
 * At a position X under a lenslet, a colour is c of the quadratic fitted to its pixels q:
 *
 *   min sum_q k w (n - c - g.t - Q(t))^2 + W ((a1 + b1 e) |g|^2 + (a2 + b2 e) |Q|^2),   W = sum_q k w
 *   t = (q - X)/(2 T),  k = max(1 - |t|^2, 0)^4 if q lies under the same lenslet, else 0
 *   n = raw/w,  w = max(white, floor),  e = s/(K max(V - 1.5 s, s/1000)),  s = noise mean K/W,  K = sum_q k
 *
 * T is the period of the mosaic, V the variance of n and s its noise part, with the variance
 * noise[colour] n/w. Where noise explains the variance, e is large and c is the mean (ridge regression;
 * Takeda, Farsiu and Milanfar 2007 for fits of neighbourhoods). No pixel: 0.
 * Under the same lenslet: abs(p_m + edge_m . (q - X)) <= 1/2 for its three (two) pairs of sides m,
 * with edge_m = E_m/|E_m|^2, E_m the step to a neighbour, and p_m = edge_m . (X - middle).
 *
 *   fit_colours   out[u, i, k, c] for row i and lenslet k
 *   to_columns    L[u, i, k, c] = sum_d matrix[c, d] out[u, i, ., d] interpolated to column k, as
 *                 `decode.cl` does
 *
 * Mapping: FOR_X of common.cl over blocks of LANES lenslets; axis 1 = u; axis 2 = i, so that items in a
 * row read the same lines of the sensor. In `to_columns` over columns; axis 1 = i; axis 2 = u.
 * tile = index of the first pixel of every colour, then (y, x) of all pixels.
 * -DLANES=1 | 16   lenslets at a time
 * -DDOWN= -DACROSS=   rows and columns of the mosaic's tile
 * -DROWS: see common.cl.
 */
#include "common.cl"

#define FAR (1 << 20) /* tiles: offset that makes remainders positive */
#define A1 0.0016f /* a1, b1, a2, b2 */
#define B1 0.39f
#define A2 0.0003f
#define B2 0.046f

#if LANES == 16
typedef float16 lane;
typedef int16 whole;
#define EACH(f, i) \
    ((lane)(f(i.s0), f(i.s1), f(i.s2), f(i.s3), f(i.s4), f(i.s5), f(i.s6), f(i.s7), f(i.s8), \
            f(i.s9), f(i.sa), f(i.sb), f(i.sc), f(i.sd), f(i.se), f(i.sf)))
#define TO_LANE convert_float16
#define TO_WHOLE convert_int16
#else
typedef float lane;
typedef int whole;
#define EACH(f, i) (f(i))
#define TO_LANE convert_float
#define TO_WHOLE convert_int
#endif
#define RAW(i) raw[i]
#define WHITE(i) white[i]

/* c of the normal equations a c = b, given by the upper triangle, c last. */
inline lane last_unknown(lane a[6][6], lane b[6])
{
#pragma unroll
    for (int p = 0; p < 5; ++p) {
        const lane inverse = 1 / a[p][p];
#pragma unroll
        for (int r = p + 1; r < 6; ++r) {
            const lane f = a[p][r] * inverse;
#pragma unroll
            for (int c = r; c < 6; ++c)
                a[r][c] -= f * a[p][c];
            b[r] -= f * b[p];
        }
    }
    return b[5] / a[5][5];
}

__kernel void fit_colours(__global float *restrict out, __global const float *restrict raw,
                          __global const float *restrict white, __global const int2 *restrict row_at,
                          __global const float2 *restrict row_part,
                          __global const int2 *restrict column_at,
                          __global const float2 *restrict column_part,
                          __global const int2 *restrict view_at,
                          __global const float2 *restrict view_part,
                          __global const float *restrict sides, __global const float *restrict edges,
                          __global const int *restrict tile, __global const float *restrict noise,
                          const float floor_, const int ny, const int nx, const int rows, const int lenslets)
{
    const int u = get_global_id(1);
    const int i = get_global_id(2);
    const int2 at = row_at[i] + view_at[u];
    const float2 part = row_part[i] + view_part[u];
    out += row_start(u, i, rows, lenslets) * 3;
    FOR_X(block, (lenslets + LANES - 1) / LANES) {
        whole y_at, x_at;
        lane y_part, x_part;
        for (int l = 0; l < LANES; ++l) {
            const int k = min(block * LANES + l, lenslets - 1);
            const float2 sum = part + column_part[k];
            const int2 carry = convert_int2(sum);
            const int2 pixel = at + column_at[k] + carry;
            ((int *)&y_at)[l] = pixel.s0;
            ((int *)&x_at)[l] = pixel.s1;
            ((float *)&y_part)[l] = sum.s0 - carry.s0;
            ((float *)&x_part)[l] = sum.s1 - carry.s1;
        }
        for (int colour = 0; colour < 3; ++colour) {
            lane m = 0, my = 0, mx = 0, myy = 0, myx = 0, mxx = 0;
            lane myyy = 0, myyx = 0, myxx = 0, mxxx = 0;
            lane myyyy = 0, myyyx = 0, myyxx = 0, myxxx = 0, mxxxx = 0;
            lane b = 0, by = 0, bx = 0, byy = 0, byx = 0, bxx = 0, square = 0, count = 0;
            lane about = 0; /* value of a nearby pixel, subtracted for accuracy */
            for (int s = tile[colour]; s < tile[colour + 1]; ++s) {
                const whole ahead_y = (tile[2 * s] - y_at + (FAR * DOWN - 1)) % DOWN;
                const whole ahead_x = (tile[2 * s + 1] - x_at + (FAR * ACROSS - 1)) % ACROSS;
                const whole first_y = y_at - 2 * DOWN + 1 + ahead_y;
                const whole first_x = x_at - 2 * ACROSS + 1 + ahead_x;
                const lane from_y = (TO_LANE(first_y - y_at) - y_part) * (0.5f / DOWN);
                const lane from_x = (TO_LANE(first_x - x_at) - x_part) * (0.5f / ACROSS);
                if (s == tile[colour]) {
                    const whole line = clamp(first_y + DOWN, (whole)(0), (whole)(ny - 1));
                    const whole column = clamp(first_x + ACROSS, (whole)(0), (whole)(nx - 1));
                    const whole pixel = line * nx + column;
                    about = EACH(RAW, pixel) / fmax(EACH(WHITE, pixel), (lane)(floor_));
                }
                for (int j = 0; j < 4; ++j) {
                    const whole y = first_y + j * DOWN;
                    const whole line = clamp(y, (whole)(0), (whole)(ny - 1));
                    const lane ty = from_y + 0.5f * j;
                    const lane rest = 1 - ty * ty;
                    const lane p0 = sides[3 * u] + ty * edges[0];
                    const lane p1 = sides[3 * u + 1] + ty * edges[1];
                    const lane p2 = sides[3 * u + 2] + ty * edges[2];
                    lane s0 = 0, s1 = 0, s2 = 0, s3 = 0, s4 = 0, r0 = 0, rx = 0, rxx = 0;
#pragma unroll
                    for (int h = 0; h < 4; ++h) {
                        const whole x = first_x + h * ACROSS;
                        const whole column = clamp(x, (whole)(0), (whole)(nx - 1));
                        const lane tx = from_x + 0.5f * h;
                        lane k = fmax(rest - tx * tx, (lane)(0));
                        k *= k;
                        k *= k;
                        const whole own = (fabs(p0 + tx * edges[3]) <= 0.5f) &
                                          (fabs(p1 + tx * edges[4]) <= 0.5f) &
                                          (fabs(p2 + tx * edges[5]) <= 0.5f) & (y == line) &
                                          (x == column);
                        k = select((lane)(0), k, own);
                        const whole pixel = line * nx + column;
                        const lane w = fmax(EACH(WHITE, pixel), (lane)(floor_));
                        const lane light = EACH(RAW, pixel) - about * w;
                        const lane kw = k * w, kr = k * light;
                        const lane w1 = kw * tx, r1 = kr * tx;
                        const lane w2 = w1 * tx;
                        const lane w3 = w2 * tx;
                        count += k;
                        square += kr * light / w;
                        s0 += kw;
                        s1 += w1;
                        s2 += w2;
                        s3 += w3;
                        s4 += w3 * tx;
                        r0 += kr;
                        rx += r1;
                        rxx += r1 * tx;
                    }
                    const lane y2 = ty * ty;
                    const lane y3 = y2 * ty;
                    m += s0;
                    my += ty * s0;
                    mx += s1;
                    myy += y2 * s0;
                    myx += ty * s1;
                    mxx += s2;
                    myyy += y3 * s0;
                    myyx += y2 * s1;
                    myxx += ty * s2;
                    mxxx += s3;
                    myyyy += y2 * y2 * s0;
                    myyyx += y3 * s1;
                    myyxx += y2 * s2;
                    myxxx += ty * s3;
                    mxxxx += s4;
                    b += r0;
                    by += ty * r0;
                    bx += rx;
                    byy += y2 * r0;
                    byx += ty * rx;
                    bxx += rxx;
                }
            }
            const lane total = fmax(m, (lane)(1e-20f));
            const lane mean = b / total;
            const lane variance = square / total - mean * mean;
            const lane random = noise[colour] * fmax(about + mean, (lane)(0)) * count / total;
            const lane detail = fmax(variance - 1.5f * random, 1e-3f * random + 1e-30f);
            const lane doubt = random / (fmax(count, (lane)(1e-20f)) * detail);
            const lane g = total * (A1 + B1 * doubt);
            const lane q = total * (A2 + B2 * doubt);
            lane a[6][6] = {{myyyy + q, myyxx, myyyx, myyy, myyx, myy},
                            {0, mxxxx + q, myxxx, myxx, mxxx, mxx},
                            {0, 0, myyxx + q, myyx, myxx, myx},
                            {0, 0, 0, myy + g, myx, my},
                            {0, 0, 0, 0, mxx + g, mx},
                            {0, 0, 0, 0, 0, total}};
            lane right[6] = {byy, bxx, byx, by, bx, b};
            const lane value = select((lane)(0), about + last_unknown(a, right), m > 0);
            for (int l = 0; l < LANES; ++l) {
                const int k = block * LANES + l;
                if (k < lenslets)
                    out[(size_t)k * 3 + colour] = ((const float *)&value)[l];
            }
        }
    }
}

__kernel void to_columns(__global float *restrict L, __global const float *restrict in,
                         __global const int *restrict near_at,
                         __global const float *restrict near_part,
                         __global const float *restrict matrix, const int rows, const int lenslets,
                         const int columns, const long start, const long stride_u,
                         const long stride_y, const long stride_x)
{
    const int i = get_global_id(1);
    const int u = get_global_id(2);
    const int parity = (i & 1) * columns;
    in += row_start(u, i, rows, lenslets) * 3;
    L += start + u * stride_u + i * stride_y;
    FOR_X(k, columns) {
        const int before = near_at[parity + k];
        const float t = near_part[parity + k];
        const float w[4] = {((1 - 0.5f * t) * t - 0.5f) * t, (1.5f * t - 2.5f) * t * t + 1,
                            ((2 - 1.5f * t) * t + 0.5f) * t, (0.5f * t - 0.5f) * t * t};
        float sum[3] = {0, 0, 0};
        for (int n = 0; n < 4; ++n) {
            const int lenslet = clamp(before + n - 1, 0, lenslets - 1);
            for (int c = 0; c < 3; ++c)
                sum[c] += w[n] * in[(size_t)lenslet * 3 + c];
        }
        for (int c = 0; c < 3; ++c)
            L[k * stride_x + c] = matrix[3 * c] * sum[0] + matrix[3 * c + 1] * sum[1] +
                                  matrix[3 * c + 2] * sum[2];
    }
}
