/* Pictures of a focused plenoptic camera: one lenslet per sample, or a blend of many.
 *
 *   nearest   out(Y) = raw(r_k(Y)),  s_k the centre nearest to Y + view/ratio: a patch of every
 *             sub-image, ratio pitch wide, turned by half a turn for ratio > 0, without gaps
 *   blend     out(Y) = sum_k w_k raw(r_k(Y)) / sum_k w_k g_k,
 *             w_k = ramp(radius - abs(d - view)) ramp(rim - abs(d)) v[kind_k],  d = r_k(Y) - s_k,
 *             ramp(t) = min(max(t + 1/2, 0), 1);  g_k = 1, with -DWHITE white(r_k(Y))
 *
 * r_k(Y) is defined in focused.cl; lattice = origin, first, second, view; samples off the sensor and lenslets of kind -1
 * are ignored. Without any weight, the nearest lenslet is used unweighted, or 0 without a
 * lenslet.
 *
 * A lenslet focused on m_k blurs a point of another m over pitch abs(m - m_k) pixels. With
 * -DTYPES=n the kinds are in focus for abs(m) from range[kind].x to range[kind].y, and
 * v = max(1 - pitch (e - least e), 0), e = distance of abs(m) from the range; m = ratio (1 + pupil) + pupil.
 *
 * Mapping: FOR_X of common.cl over x; axis 1 = y; axis 2 = plane, with ratio[plane]; with -DMAP
 * ratio[y, x]. -DCHANNELS=n, -DLINEAR, -DWHITE, -DMAP: above and focused.cl. -DROWS: see common.cl.
 */
#include "focused.cl"

inline float ramp(const float t)
{
    return clamp(t + 0.5f, 0.0f, 1.0f);
}

/* Writes sum/level of every channel, 0 without a level. */
inline void write_ratio(__global float *out, const float *sum, const float *level)
{
    for (int c = 0; c < CHANNELS; ++c)
        out[c] = level[c] > 0 ? sum[c] / level[c] : 0;
}

/* Sample at r_k(Y) of the lenslet nearest to q (from the origin). */
inline void take_nearest(float *sum, float *level, __global const float *restrict raw,
                         __global const float *restrict white, __global const int2 *restrict at,
                         __global const float2 *restrict part, __global const int *restrict kind,
                         const int2 y_at, const float2 y_part, const float2 q, const float ratio,
                         const float2 first, const float2 second, const int lines,
                         const int lenses, const int ny, const int nx)
{
    const int2 k = nearest_lens(q, first, second);
    if (k.s0 < 0 || k.s0 >= lines || k.s1 < 0 || k.s1 >= lenses)
        return;
    const int lens = k.s0 * lenses + k.s1;
    const float2 d = ratio * (convert_float2(at[lens] - y_at) + (part[lens] - y_part));
    if (kind[lens] < 0 || !is_recorded(at[lens], part[lens] + d, ny, nx))
        return;
    add_sample(sum, 1, raw, at[lens], part[lens] + d, ny, nx);
#ifdef WHITE
    add_sample(level, 1, white, at[lens], part[lens] + d, ny, nx);
#else
    for (int c = 0; c < CHANNELS; ++c)
        level[c] = 1;
#endif
}

#ifdef MAP
#define RATIO(y, x, plane) ratios[(size_t)(y) * width + (x)]
#else
#define RATIO(y, x, plane) ratios[plane]
#endif

__kernel void nearest(__global float *restrict out, __global const float *restrict raw,
                      __global const float *restrict white, __global const int2 *restrict at,
                      __global const float2 *restrict part, __global const int *restrict kind,
                      __global const int *restrict row_at, __global const float *restrict row_part,
                      __global const int *restrict column_at,
                      __global const float *restrict column_part,
                      __global const float *restrict ratios,
                      __global const float2 *restrict lattice, const int lines, const int lenses,
                      const int ny, const int nx, const int height, const int width)
{
    const float2 origin = lattice[0], first = lattice[1], second = lattice[2], view = lattice[3];
    const int y = get_global_id(1), plane = get_global_id(2);
    FOR_X(x, width) {
        const size_t pixel = row_start(plane, y, height, width) + x;
        const float ratio = RATIO(y, x, plane);
        const int2 y_at = (int2)(row_at[y], column_at[x]);
        const float2 y_part = (float2)(row_part[y], column_part[x]);
        const float2 q = convert_float2(y_at) + y_part + view / ratio - origin;
        float sum[CHANNELS] = {0}, level[CHANNELS] = {0};
        take_nearest(sum, level, raw, white, at, part, kind, y_at, y_part, q, ratio, first, second,
                     lines, lenses, ny, nx);
        write_ratio(out + pixel * CHANNELS, sum, level);
    }
}

#ifdef TYPES
/* Weights of the lenslet kinds at a ratio. */
inline void type_weights(float *weight, __global const float2 *restrict range, const float ratio,
                         const float pupil, const float pitch)
{
    const float m = fabs(ratio * (1 + pupil) + pupil);
    float least = INFINITY;
    for (int t = 0; t < TYPES; ++t) {
        weight[t] = fmax(fmax(range[t].s0 - m, m - range[t].s1), 0.0f);
        least = fmin(least, weight[t]);
    }
    for (int t = 0; t < TYPES; ++t)
        weight[t] = fmax(1 - pitch * (weight[t] - least), 0.0f);
}
#endif

__kernel void blend(__global float *restrict out, __global const float *restrict raw,
                    __global const float *restrict white, __global const int2 *restrict at,
                    __global const float2 *restrict part, __global const int *restrict kind,
                    __global const int *restrict row_at, __global const float *restrict row_part,
                    __global const int *restrict column_at,
                    __global const float *restrict column_part,
                    __global const float *restrict ratios,
                    __global const float2 *restrict lattice, const int lines, const int lenses,
                    const int ny, const int nx, const int height, const int width,
                    __global const float2 *restrict range, const float radius, const float rim,
                    const float pupil, const float pitch)
{
    const float2 origin = lattice[0], first = lattice[1], second = lattice[2], view = lattice[3];
    const int y = get_global_id(1), plane = get_global_id(2);
    const float length = sqrt(second.s0 * second.s0 + second.s1 * second.s1);
    const float2 along = second / length;
    const float apart = cross2(first, along);
    FOR_X(x, width) {
        const size_t pixel = row_start(plane, y, height, width) + x;
        const float ratio = RATIO(y, x, plane);
        const int2 y_at = (int2)(row_at[y], column_at[x]);
        const float2 y_part = (float2)(row_part[y], column_part[x]);
        const float2 q = convert_float2(y_at) + y_part + view / ratio - origin;
        float sum[CHANNELS] = {0}, level[CHANNELS] = {0};
#ifdef TYPES
        float of_type[TYPES];
        type_weights(of_type, range, ratio, pupil, pitch);
#endif
        /* Lines i of the lattice within reach of q, and on each the lenslets j. */
        const float reach = (radius + 0.5f) / fabs(ratio) + 0.01f;
        const float middle = cross2(q, along) / apart, span = reach / fabs(apart);
        const int last = (int)fmin(floor(middle + span), (float)(lines - 1));
        for (int i = (int)fmax(ceil(middle - span), 0.0f); i <= last; ++i) {
            const float2 way = q - i * first;
            const float off = cross2(way, along);
            const float half_chord = sqrt(fmax(reach * reach - off * off, 0.0f));
            const float on = way.s0 * along.s0 + way.s1 * along.s1;
            const int end = (int)fmin(floor((on + half_chord) / length), (float)(lenses - 1));
            for (int j = (int)fmax(ceil((on - half_chord) / length), 0.0f); j <= end; ++j) {
                const int lens = i * lenses + j;
                if (kind[lens] < 0)
                    continue;
                const float2 d = ratio * (convert_float2(at[lens] - y_at) + (part[lens] - y_part));
                const float2 from = d - view;
                float w = ramp(radius - sqrt(from.s0 * from.s0 + from.s1 * from.s1)) *
                          ramp(rim - sqrt(d.s0 * d.s0 + d.s1 * d.s1));
#ifdef TYPES
                w *= of_type[kind[lens]];
#endif
                if (!(w > 0) || !is_recorded(at[lens], part[lens] + d, ny, nx))
                    continue;
                add_sample(sum, w, raw, at[lens], part[lens] + d, ny, nx);
#ifdef WHITE
                add_sample(level, w, white, at[lens], part[lens] + d, ny, nx);
#else
                for (int c = 0; c < CHANNELS; ++c)
                    level[c] += w;
#endif
            }
        }
        if (!(level[0] > 0))
            take_nearest(sum, level, raw, white, at, part, kind, y_at, y_part, q, ratio, first,
                         second, lines, lenses, ny, nx);
        write_ratio(out + pixel * CHANNELS, sum, level);
    }
}
