/* Distance of a point's images under neighbouring lenslets of a focused plenoptic camera.
 *
 * A pair (a, b) of lenslets sees the points about the middle of s_a and s_b at, see focused.cl,
 *
 *   A(d) = raw(s_a - ratio (s_b - s_a)/2 + d),   B(d) = raw(s_b + ratio (s_b - s_a)/2 + d)
 *
 * and e = A - B vanishes in a window abs(d) < window if the ratio is right. With sums over the
 * window, weighted by w(d) = 1 - (d/window)^2 where both positions are lit, and over the pairs, each
 * pair's mean subtracted:
 *
 *   match     cost[h, lens] = (sum e^2 + noise) / (sum A^2 + B^2 + noise), 2 if a window is not visible
 *   refine    ratio -= sum e e' / sum e'^2, e' = -(A' + B')/2 along s_b - s_a (Gauss-Newton; Lucas &
 *             Kanade 1981);  out = ratio, sum e^2, sum e'^2, sum A^2 + B^2, sum w per lenslet
 *   spots     out = sum I^2, sum I^2 y, sum I^2 x, (y, x) from s_k, over abs((y, x)) < rim and
 *             abs((y, x) - about_k) < radius
 *
 * The lenslets' apertures dim the rims of the sub-images over abs(m_f) pitch, m_f where they focus,
 * as from the middle: lit is what lies within rim - shrink max(abs(ratio), least) of a centre.
 * noise = variance of a pixel times 2 sum w. Pairs are (i_a, j_a, i_b, j_b) from the lenslet's own
 * indices. match interpolates linearly, refine by cubic convolution.
 *
 * Mapping: one item a lenslet. -DCHANNELS=n, -DLINEAR: see focused.cl.
 */
#include "focused.cl"

/* Position of a window: its middle pixel and the fraction of a pixel. */
inline float2 window_at(int2 *middle, const int2 at, const float2 place)
{
    const int2 carry = convert_int2(floor(place));
    *middle = at + carry;
    return place - convert_float2(carry);
}

/* True if all pixels of a window, taps included, lie on the sensor. */
inline bool is_inside(const int2 middle, const int half_width, const int ny, const int nx)
{
    return middle.s0 - half_width >= 1 && middle.s0 + half_width < ny - 2 &&
           middle.s1 - half_width >= 1 && middle.s1 + half_width < nx - 2;
}

/* The lenslets of a pair: indices into the table, or false if either is missing. */
inline bool lenses_of(int *a, int *b, const int4 pair, const int lens, const int lines,
                      const int lenses, __global const int *restrict kind)
{
    const int i = lens / lenses, j = lens % lenses;
    const int ia = i + pair.s0, ja = j + pair.s1, ib = i + pair.s2, jb = j + pair.s3;
    if (min(ia, ib) < 0 || max(ia, ib) >= lines || min(ja, jb) < 0 || max(ja, jb) >= lenses)
        return false;
    *a = ia * lenses + ja;
    *b = ib * lenses + jb;
    return kind[*a] >= 0 && kind[*b] >= 0;
}

/* Weight of position d in a window whose middle is `off` and -off from the two centres. */
inline float window_weight(const float2 d, const float2 off, const float window, const float lit)
{
    const float2 a = d - off, b = d + off;
    const float farther = fmax(a.s0 * a.s0 + a.s1 * a.s1, b.s0 * b.s0 + b.s1 * b.s1);
    const float square = (d.s0 * d.s0 + d.s1 * d.s1) / (window * window);
    return lit > 0 && farther < lit * lit ? fmax(1 - square, 0.0f) : 0;
}

inline float bilinear(__global const float *restrict raw, const int y, const int x, const float2 t,
                      const int nx)
{
    const float above = (1 - t.s1) * grey(raw, y, x, nx) + t.s1 * grey(raw, y, x + 1, nx);
    const float below = (1 - t.s1) * grey(raw, y + 1, x, nx) + t.s1 * grey(raw, y + 1, x + 1, nx);
    return (1 - t.s0) * above + t.s0 * below;
}

__kernel void match(__global float *restrict cost, __global const float *restrict raw,
                    __global const int2 *restrict at, __global const float2 *restrict part,
                    __global const int *restrict kind, __global const int4 *restrict pairs,
                    __global const float *restrict ratios, const int count, const int planes,
                    const int lines, const int lenses, const int ny, const int nx,
                    const float window, const float rim, const float shrink, const float least,
                    const float noise)
{
    const int lens = get_global_id(0), half_width = (int)window;
    if (lens >= lines * lenses)
        return;
    for (int plane = 0; plane < planes; ++plane) {
        const float ratio = ratios[plane];
        const float lit = rim - shrink * fmax(fabs(ratio), least);
        float apart = 0, both = 0, seen = 0;
        for (int p = 0; p < count; ++p) {
            int a, b;
            if (!lenses_of(&a, &b, pairs[p], lens, lines, lenses, kind))
                continue;
            const float2 off =
                0.5f * ratio * (convert_float2(at[b] - at[a]) + (part[b] - part[a]));
            int2 in_a, in_b;
            const float2 ta = window_at(&in_a, at[a], part[a] - off);
            const float2 tb = window_at(&in_b, at[b], part[b] + off);
            if (!is_inside(in_a, half_width, ny, nx) || !is_inside(in_b, half_width, ny, nx))
                continue;
            const float base = grey(raw, in_a.s0, in_a.s1, nx);
            float w = 0, wa = 0, wb = 0, waa = 0, wbb = 0, wee = 0;
            for (int y = -half_width; y <= half_width; ++y)
                for (int x = -half_width; x <= half_width; ++x) {
                    const float share = window_weight((float2)(y, x), off, window, lit);
                    if (!(share > 0))
                        continue;
                    const float A = bilinear(raw, in_a.s0 + y, in_a.s1 + x, ta, nx) - base;
                    const float B = bilinear(raw, in_b.s0 + y, in_b.s1 + x, tb, nx) - base;
                    w += share;
                    wa += share * A;
                    wb += share * B;
                    waa += share * A * A;
                    wbb += share * B * B;
                    wee += share * (A - B) * (A - B);
                }
            if (w > 0) {
                apart += wee - (wa - wb) * (wa - wb) / w;
                both += waa - wa * wa / w + wbb - wb * wb / w;
                seen += w;
            }
        }
        const float extra = 2 * noise * seen;
        cost[(size_t)plane * lines * lenses + lens] =
            both + extra > 0 ? (fmax(apart, 0.0f) + extra) / (fmax(both, 0.0f) + extra) : 2;
    }
}

/* raw at pixel (y, x) + t, and its derivatives, as (value, by y, by x). */
inline float3 value_and_slopes(__global const float *restrict raw, const int y, const int x,
                               const float *wy, const float *sy, const float *wx, const float *sx,
                               const int nx)
{
    float3 all = (float3)(0, 0, 0);
    for (int a = 0; a < 4; ++a) {
        float line = 0, slope = 0;
        for (int b = 0; b < 4; ++b) {
            const float value = grey(raw, y + a - 1, x + b - 1, nx);
            line += wx[b] * value;
            slope += sx[b] * value;
        }
        all += (float3)(wy[a] * line, sy[a] * line, wy[a] * slope);
    }
    return all;
}

/* Adds a pair's sums e e', e'^2, e^2, A^2 + B^2, w to sums. */
inline void add_pair(float *sums, __global const float *restrict raw, const int2 in_a,
                     const float2 ta, const int2 in_b, const float2 tb, const float2 way,
                     const float2 off, const float window, const float lit, const int nx)
{
    const int half_width = (int)window;
    float wya[4], wxa[4], wyb[4], wxb[4], sya[4], sxa[4], syb[4], sxb[4];
    set_weights(wya, ta.s0);
    set_weights(wxa, ta.s1);
    set_weights(wyb, tb.s0);
    set_weights(wxb, tb.s1);
    vstore4(tap_slopes(ta.s0), 0, sya);
    vstore4(tap_slopes(ta.s1), 0, sxa);
    vstore4(tap_slopes(tb.s0), 0, syb);
    vstore4(tap_slopes(tb.s1), 0, sxb);
    const float base = grey(raw, in_a.s0, in_a.s1, nx);
    float w = 0, wa = 0, wb = 0, waa = 0, wbb = 0, wee = 0, wd = 0, wdd = 0, wde = 0;
    for (int y = -half_width; y <= half_width; ++y)
        for (int x = -half_width; x <= half_width; ++x) {
            const float share = window_weight((float2)(y, x), off, window, lit);
            if (!(share > 0))
                continue;
            const float3 a = value_and_slopes(raw, in_a.s0 + y, in_a.s1 + x, wya, sya, wxa, sxa, nx);
            const float3 b = value_and_slopes(raw, in_b.s0 + y, in_b.s1 + x, wyb, syb, wxb, sxb, nx);
            const float A = a.s0 - base, B = b.s0 - base, e = A - B;
            const float slope = -0.5f * ((a.s1 + b.s1) * way.s0 + (a.s2 + b.s2) * way.s1);
            w += share;
            wa += share * A;
            wb += share * B;
            waa += share * A * A;
            wbb += share * B * B;
            wee += share * e * e;
            wd += share * slope;
            wdd += share * slope * slope;
            wde += share * slope * e;
        }
    if (w > 0) {
        sums[0] += wde - wd * (wa - wb) / w;
        sums[1] += fmax(wdd - wd * wd / w, 0.0f);
        sums[2] += fmax(wee - (wa - wb) * (wa - wb) / w, 0.0f);
        sums[3] += fmax(waa - wa * wa / w + wbb - wb * wb / w, 0.0f);
        sums[4] += w;
    }
}

__kernel void refine(__global float *restrict out, __global const float *restrict raw,
                     __global const int2 *restrict at, __global const float2 *restrict part,
                     __global const int *restrict kind, __global const int4 *restrict pairs,
                     __global const float *restrict start, const int count, const int rounds,
                     const int lines, const int lenses, const int ny, const int nx,
                     const float window, const float rim, const float shrink, const float least,
                     const float step)
{
    const int lens = get_global_id(0);
    if (lens >= lines * lenses)
        return;
    float ratio = start[lens], sums[5];
    for (int round = 0; round <= rounds; ++round) {
        const float lit = rim - shrink * fmax(fabs(ratio), least);
        for (int s = 0; s < 5; ++s)
            sums[s] = 0;
        for (int p = 0; p < count; ++p) {
            int a, b;
            if (!lenses_of(&a, &b, pairs[p], lens, lines, lenses, kind))
                continue;
            const float2 way = convert_float2(at[b] - at[a]) + (part[b] - part[a]);
            const float2 off = 0.5f * ratio * way;
            int2 in_a, in_b;
            const float2 ta = window_at(&in_a, at[a], part[a] - off);
            const float2 tb = window_at(&in_b, at[b], part[b] + off);
            if (sqrt(off.s0 * off.s0 + off.s1 * off.s1) + 0.5f * window < lit &&
                is_inside(in_a, (int)window, ny, nx) && is_inside(in_b, (int)window, ny, nx))
                add_pair(sums, raw, in_a, ta, in_b, tb, way, off, window, lit, nx);
        }
        if (round < rounds && sums[1] > 0)
            ratio -= clamp(sums[0] / sums[1], -step, step);
    }
    out[5 * lens] = ratio;
    out[5 * lens + 1] = sums[2];
    out[5 * lens + 2] = sums[1];
    out[5 * lens + 3] = sums[3];
    out[5 * lens + 4] = sums[4];
}

__kernel void spots(__global float *restrict out, __global const float *restrict raw,
                    __global const int2 *restrict at, __global const float2 *restrict part,
                    __global const int *restrict kind, __global const float2 *restrict about,
                    const int count, const int ny, const int nx, const float rim,
                    const float radius)
{
    const int lens = get_global_id(0), half_width = (int)rim + 1;
    if (lens >= count)
        return;
    float sum = 0, along_y = 0, along_x = 0;
    const int2 middle = at[lens];
    for (int y = max(-half_width, -middle.s0); y <= min(half_width, ny - 1 - middle.s0); ++y)
        for (int x = max(-half_width, -middle.s1); x <= min(half_width, nx - 1 - middle.s1); ++x) {
            const float2 d = (float2)(y, x) - part[lens];
            const float2 from = d - about[lens];
            if (kind[lens] < 0 || d.s0 * d.s0 + d.s1 * d.s1 >= rim * rim ||
                from.s0 * from.s0 + from.s1 * from.s1 >= radius * radius)
                continue;
            const float value = grey(raw, middle.s0 + y, middle.s1 + x, nx);
            sum += value * value;
            along_y += value * value * d.s0;
            along_x += value * value * d.s1;
        }
    out[3 * lens] = sum;
    out[3 * lens + 1] = along_y;
    out[3 * lens + 2] = along_x;
}
