/* Highest peak of a curve over the planes at every pixel, in batches of planes.
 *
 *   track_peaks   best, second = highest and second highest local maximum of e(d);
 *                 place = vertex of the parabola through the highest and its two neighbours, h0
 *                 below and h1 above, which lies within half a step;  curvature = -e'' there
 *   confidence    (1 - second/best) k/(1 + k),  k = -e''/e at the peak, in 1/(px a view)^2
 *
 * -DLOWEST: e is minus the curve (a cost), which gives its lowest minimum:
 * (1 - best/second) k/(1 + k), k = e''/e of the cost.
 * An end of the curve has no parabola: curvature 0. Where no plane exceeds its neighbours nothing
 * is tracked, and the confidence is 0. A plane level with both counts as a second peak, since a plateau
 * has no position.
 *
 * Pixels lie one after the other, `size` in a plane; arrays are padded by 15 floats.
 * Mapping: an item owns a pixel; -DROWS: `length` pixels, LANES at a time, -DLANES=4 | 8 | 16.
 */
#ifdef ROWS
#include "vectors.cl"
#define STEP LANES
#define LOAD(from) load(from)
#define STORE(to, value) store(to, value)
#else
#define STEP 1
typedef float vec;
#define LOAD(from) (*(from))
#define STORE(to, value) (*(to) = (value))
#endif

#ifdef LOWEST
#define SIGN (-1.0f)
#else
#define SIGN 1.0f
#endif

/* Planes `first` ... `first + count - 1` of `curve`; places[k] = (d, h0, h1), a step of 0 at an end.
 * `fresh`: nothing is tracked yet; `start` is the result without a peak. */
__kernel void track_peaks(__global float *restrict best, __global float *restrict second,
                          __global float *restrict place, __global float *restrict curvature,
                          __global const float *restrict curve, __global const float *restrict places,
                          const int first, const int count, const int fresh, const float start,
                          const int size, const int length)
{
    const int begin = get_global_id(0) * length;
    for (int i = begin; i < min(begin + length, size); i += STEP) {
        const vec before = fresh ? (vec)(-INFINITY) : LOAD(best + i);
        vec high = before, next = fresh ? (vec)(-INFINITY) : LOAD(second + i);
        vec d = 0, h0 = 0, h1 = 0, rise = 0, fall = 0; /* of the current maximum */
        __global const float *plane = curve + (size_t)first * size + i;
        vec below = SIGN * LOAD(plane - (places[1] > 0.0f ? size : 0));
        vec at = SIGN * LOAD(plane);
        for (int k = 0; k < count; ++k) {
            const float down = places[3 * k + 1], up = places[3 * k + 2];
            plane += size;
            const vec above = up > 0.0f ? SIGN * LOAD(plane) : below;
            const vec left = at - (down > 0.0f ? below : above);
            const vec right = at - above;
            const vec top = left >= 0.0f && right > 0.0f ? at : (vec)(-INFINITY);
            const vec level = left == 0.0f && right == 0.0f ? at : top;
            const vec other = top > high ? high : level;
            next = other > next ? other : next;
            d = top > high ? (vec)(places[3 * k]) : d;
            h0 = top > high ? (vec)(down) : h0;
            h1 = top > high ? (vec)(up) : h1;
            rise = top > high ? left : rise;
            fall = top > high ? right : fall;
            high = top > high ? top : high;
            below = at;
            at = above;
        }
        const vec s0 = rise / (h0 > 0.0f ? h0 : (vec)(1.0f));
        const vec s1 = fall / (h1 > 0.0f ? h1 : (vec)(1.0f));
        const vec sum = h0 > 0.0f && h1 > 0.0f ? s0 + s1 : (vec)(0.0f);
        const vec off = sum > 0.0f ? 0.5f * (s0 * h1 - s1 * h0) / sum : (vec)(0.0f);
        const vec bend = sum > 0.0f ? sum * 2.0f / (h0 + h1) : (vec)(0.0f);
        STORE(best + i, high);
        STORE(second + i, next);
        STORE(place + i, high > before ? d + off : fresh ? (vec)(start) : LOAD(place + i));
        STORE(curvature + i, high > before ? bend : fresh ? (vec)(0.0f) : LOAD(curvature + i));
    }
}

inline float sureness(const float best, const float second, const float curvature)
{
#ifdef LOWEST
    const float margin = isfinite(second) ? (second < best ? 1.0f - best / second : 0.0f) : 1.0f;
#else
    const float margin = second > 0.0f ? 1.0f - second / best : 1.0f;
#endif
    return curvature > 0.0f ? margin * curvature / (curvature + fabs(best)) : 0.0f;
}

__kernel void confidence(__global float *restrict out, __global const float *restrict best,
                         __global const float *restrict second,
                         __global const float *restrict curvature, const int size, const int length)
{
    const int begin = get_global_id(0) * length;
    for (int i = begin; i < min(begin + length, size); ++i)
        out[i] = sureness(best[i], second[i], curvature[i]);
}
