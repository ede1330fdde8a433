/* fit of refine.cl in vectors, for CPUs.
 *
 *   out = a of the plane a + b_y s + b_x t through d - B/(A + prior) of the neighbours
 *
 * An item is LANES pixels of a row. The moments of a row of neighbours are summed over t first,
 * then multiplied by powers of s.
 *
 * -DLANES=4 | 8 | 16, -DCHANNELS=n, -DRADIUS=n
 */
#include "common.cl"
#include "vectors.cl"
#include "bell.cl"

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void fit_rows(__global float *restrict out, __global float *restrict known,
                       __global const float *restrict A, __global const float *restrict B,
                       __global const float *restrict disparity, __global const float *restrict I,
                       __global const float *restrict alike, __global const float *restrict near,
                       __global const float *restrict prior, const float level, const float ridge,
                       const float most, const int ny, const int nx)
{
    const int x0 = get_global_id(0) * LANES, y = get_global_id(1);
    if (x0 >= nx)
        return;
    const long i = (long)y * nx + x0, size = (long)ny * nx;
    const vec none = (vec)(0.0f);
    const vec here = load_within(disparity, i, size), same = load_within(alike, i, size);
    const vec close = load_within(near, i, size);
    vec colour[CHANNELS];
    for (int c = 0; c < CHANNELS; ++c)
        colour[c] = load_within(I + c * size, i, size);
    vec w = none, ws = none, wt = none, wss = none, wst = none, wtt = none; /* sums of weights */
    vec v = none, vs = none, vt = none, sure = none; /* sums of values, and of information */
    const int inner = x0 >= RADIUS && x0 + LANES + RADIUS <= nx;
    for (int s = -LESS(RADIUS, y); s <= LESS(RADIUS, ny - 1 - y); ++s) {
        vec row_w = none, row_wt = none, row_wtt = none, row_v = none, row_vt = none;
        for (int t = -RADIUS; t <= RADIUS; ++t) {
            const long k = i + (long)s * nx + t;
#define LOAD(from) (inner ? load((from) + k) : load_within(from, k, size))
            vec q = close * (vec)((float)(s * s + t * t)), unlike = none;
            for (int c = 0; c < CHANNELS; ++c) {
                const vec e = LOAD(I + c * size) - colour[c];
                unlike += e * e;
            }
            const vec rise = LOAD(disparity) - here, of = LOAD(A), a = of + LOAD(prior);
            q += unlike * same + (vec)(level) * rise * rise;
            vec share = bells(q);
            if (!inner) {
                const ivec x = LANE + (ivec)(x0 + t);
                share = ((x >= (ivec)(0)) & (x < (ivec)(nx))) ? share : none;
            }
            const vec limit = (vec)(most) * a, weight = share * a;
            vec step = -LOAD(B);
            step = step > -limit ? step : -limit;
            step = step < limit ? step : limit;
            const vec value = weight * rise + share * step;
            const vec right = (vec)((float)t);
            row_w += weight;
            row_wt += weight * right;
            row_wtt += weight * (vec)(t * t + ridge);
            row_v += value;
            row_vt += value * right;
            sure += share * of;
        }
        const vec down = (vec)((float)s);
        w += row_w;
        ws += row_w * down;
        wt += row_wt;
        wss += row_w * (vec)(s * s + ridge);
        wst += row_wt * down;
        wtt += row_wtt;
        v += row_v;
        vs += row_v * down;
        vt += row_vt;
    }
    const vec c = wss * wtt - wst * wst, cs = wt * wst - ws * wtt, ct = ws * wst - wt * wss;
    const vec det = w * c + ws * cs + wt * ct;
    const vec plane = c * v + cs * vs + ct * vt;
    const vec moved = here + (det > (vec)(1e-6f) * w * c ? plane / det : v / w);
    if (x0 + LANES <= nx) {
        store(out + i, moved);
        store(known + i, sure);
    } else {
        store_some(out + i, moved, nx - x0);
        store_some(known + i, sure, nx - x0);
    }
}
