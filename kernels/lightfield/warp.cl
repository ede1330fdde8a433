/* Views, or a raw image, from a picture and a disparity, and the gradients of a loss through them.
 *
 *   L[view, y, x, c] = P(y + d[y, x] s_y, x + d[y, x] s_x)[c],   (s_y, s_x) = steps[view]
 *
 * interpolated linearly; positions off the picture use its edge. With g the gradient of the
 * loss with respect to L,
 *
 *   of_disparity[y, x]    = sum_view,c g[view, y, x, c] (s_y dP/dy + s_x dP/dx)[c]
 *   of_picture[Y, X, c]   = sum_view,y,x g[view, y, x, c] t(py - Y) t(px - X),  t(r) = max(1 - |r|, 0)
 *
 * at the position (py, px) of (y, x). Along an axis off the picture the slope of P is 0; at
 * integer positions it is the slope towards the next pixel. Sums have a fixed order, so results are
 * bitwise reproducible.
 *
 * -DLENSLETS: L is the raw image. (y, x) is a lenslet with its disparity, at
 * across[y % 2][x] + part[y % 2][x] of row y of the picture, which is `wide` pixels wide; views are its
 * pixels, of which `view` is L[index[view, y, x]], none for a negative index. It is
 * white[index] P(...), with s = steps[view] + own[y, x]; the elements of `own` lie within own_least and
 * own_most, and columns of the picture are `spacing` columns of lenslets apart.
 *
 * Mapping: views and of_disparity, FOR_X of common.cl over x, axis 1 = y, axis 2 = view (views).
 * of_picture with -DROWS: an item = `height` rows, to which it adds contributions, axis 0; else an
 * item = a sample s = X channels + c, axis 0, and Y, axis 1, which gathers contributions. All
 * disparities lie within `least` and `most`.
 * -DCHANNELS=1 | 3: number of channels, if 1 or 3; 1 with -DLENSLETS. -DROWS: see common.cl.
 */
#include "common.cl"

#ifdef CHANNELS
#define COUNT CHANNELS
#else
#define COUNT channels
#endif

#ifdef LENSLETS
#define TABLES \
    __global const int *restrict index, __global const float *restrict white, \
        __global const float2 *restrict own, __global const int *restrict across, \
        __global const float *restrict part, const int wide,
#define BOUNDS const float2 own_least, const float2 own_most, const float spacing,
#define SAMPLE(view, y, x) index[row_start(view, y, ny, nx) + x]
#define IS_SEEN(at) ((at) >= 0)
#define WHITE(at) white[at]
#define STEP(y, x) (step + own[(size_t)(y) * nx + x])
#define BACK (step + own_least)
#define AHEAD (step + own_most)
#define COLUMN(y, x) across[(y & 1) * nx + x]
#define PART(y, x, move) (part[(y & 1) * nx + x] + move)
#define WIDE wide
#else
#define TABLES
#define BOUNDS
#define SAMPLE(view, y, x) (row_start(view, y, ny, nx * COUNT) + x * COUNT)
#define IS_SEEN(at) 1
#define WHITE(at) 1.0f
#define STEP(y, x) step
#define BACK step
#define AHEAD step
#define COLUMN(y, x) x
#define PART(y, x, move) move
#define WIDE nx
#endif

/* The pixel before a position i + shift on an axis of n, the fraction to the next one, and a flag for
 * positions on the picture. Comparisons let PoCL vectorise a row (clamp and floor do not); a NaN shift
 * is off the picture. */
inline int place(int i, float shift, int n, float *part, int *within)
{
    const float offset = shift > -n ? (shift < n ? shift : n) : -n;
    const int below = (int)offset, whole = below - (offset < below);
    const int at = i + whole;
    *within = at >= 0 && at < n - 1;
    *part = *within ? offset - whole : 0.0f;
    return at < 0 ? 0 : at < n ? at : n - 1;
}

/* Where a view with `step` sees (y, x) of a disparity: pixel (i, j) of the picture, the fractions
 * b and a to the next ones, and flags for positions on the picture, down and right. */
#define LOOK_UP(disparity) \
    const float turn_y = STEP(y, x).x, turn_x = STEP(y, x).y; \
    const float moved = disparity; \
    float b, a; \
    int down, right; \
    const int i = place(y, moved * turn_y, ny, &b, &down); \
    const int j = place(COLUMN(y, x), PART(y, x, moved * turn_x), WIDE, &a, &right)

__kernel void views(__global float *restrict L, __global const float *restrict P,
                    __global const float *restrict d, __global const float2 *restrict steps,
                    const int ny, const int nx, TABLES const int channels)
{
    const int y = get_global_id(1), view = get_global_id(2);
    const float2 step = steps[view];
    FOR_X(x, nx) {
        const long at = SAMPLE(view, y, x);
        if (IS_SEEN(at)) {
            LOOK_UP(d[(size_t)y * nx + x]);
            __global const float *from = P + ((size_t)i * WIDE + j) * COUNT;
            const size_t below = down ? (size_t)WIDE * COUNT : 0;
            const size_t beside = right ? COUNT : 0;
            for (int c = 0; c < COUNT; ++c)
                L[at + c] = WHITE(at)
                    * ((1.0f - b) * ((1.0f - a) * from[c] + a * from[beside + c])
                       + b * ((1.0f - a) * from[below + c] + a * from[below + beside + c]));
        }
    }
}

__kernel void of_disparity(__global float *restrict out, __global const float *restrict g,
                           __global const float *restrict P, __global const float *restrict d,
                           __global const float2 *restrict steps, const int count, const int ny,
                           const int nx, TABLES const int channels)
{
    const int y = get_global_id(1);
    FOR_X(x, nx) {
        const float shift = d[(size_t)y * nx + x];
        float sum = 0.0f;
        for (int view = 0; view < count; ++view) {
            const long at = SAMPLE(view, y, x);
            if (!IS_SEEN(at))
                continue;
            const float2 step = steps[view];
            LOOK_UP(shift);
            __global const float *from = P + ((size_t)i * WIDE + j) * COUNT;
            const size_t below = down ? (size_t)WIDE * COUNT : 0;
            const size_t beside = right ? COUNT : 0;
            for (int c = 0; c < COUNT; ++c) {
                const float p00 = from[c], p01 = from[beside + c];
                const float p10 = from[below + c], p11 = from[below + beside + c];
                const float slope_y = (1.0f - a) * (p10 - p00) + a * (p11 - p01);
                const float slope_x = (1.0f - b) * (p01 - p00) + b * (p11 - p10);
                sum += WHITE(at) * g[at + c] * (turn_y * slope_y + turn_x * slope_x);
            }
        }
        out[(size_t)y * nx + x] = sum;
    }
}

/* Rows (or columns) of n whose positions may come next to those from `low` to `high`, moved by
 * disparities times steps between `back` and `ahead`. Positions beyond an edge map to it. */
inline int2 sources(int low, int high, float back, float ahead, float least, float most, int n)
{
    const float2 ends = (float2)(least, most);
    const float2 one = back * ends, other = ahead * ends;
    const float near = fmin(fmin(one.x, one.y), fmin(other.x, other.y));
    const float far = fmax(fmax(one.x, one.y), fmax(other.x, other.y));
    const float a = clamp(near, (float)(-n), (float)n), b = clamp(far, (float)(-n), (float)n);
    return (int2)(low == 0 ? 0 : max(low - 2 - (int)floor(b), 0),
                  high == n - 1 ? n - 1 : min(high + 1 - (int)floor(a), n - 1));
}

#ifdef LENSLETS
/* Columns of nx lenslets that lie within columns of the picture, of which there are n. */
inline int2 lenslets(int2 columns, float spacing, int nx, int n)
{
    const int first = (int)floor((columns.s0 - 1) * spacing) - 1;
    const int last = (int)ceil((columns.s1 + 1) * spacing) + 1;
    return (int2)(columns.s0 == 0 ? 0 : max(first, 0),
                  columns.s1 == n - 1 ? nx - 1 : min(last, nx - 1));
}
#endif

__kernel void of_picture(__global float *restrict out, __global const float *restrict g,
                         __global const float *restrict d, __global const float2 *restrict steps,
                         const int count, const int ny, const int nx, const int channels,
                         const float least, const float most, TABLES BOUNDS const int height)
{
#ifdef ROWS
    const int first = get_global_id(0) * height, last = min(first + height, ny) - 1;
    const size_t width = (size_t)WIDE * COUNT;
    for (size_t s = first * width; s < (last + 1) * width; ++s)
        out[s] = 0.0f;
    for (int view = 0; view < count; ++view) {
        const float2 step = steps[view];
        const int2 rows = sources(first, last, BACK.x, AHEAD.x, least, most, ny);
        for (int y = rows.s0; y <= rows.s1; ++y)
            for (int x = 0; x < nx; ++x) {
                const long at = SAMPLE(view, y, x);
                if (!IS_SEEN(at))
                    continue;
                LOOK_UP(d[(size_t)y * nx + x]);
                if (i > last || i + 1 < first)
                    continue;
                for (int k = i; k <= i + down; ++k) {
                    if (k < first || k > last)
                        continue;
                    const float w = WHITE(at) * (k == i ? 1.0f - b : b);
                    __global float *to = out + ((size_t)k * WIDE + j) * COUNT;
                    for (int c = 0; c < COUNT; ++c) {
                        const float value = w * g[at + c];
                        to[c] += (1.0f - a) * value;
                        if (right)
                            to[COUNT + c] += a * value;
                    }
                }
            }
    }
#else
    const int s = get_global_id(0), Y = get_global_id(1);
    if (s >= WIDE * COUNT)
        return;
    const int X = s / COUNT, c = s % COUNT;
    float sum = 0.0f;
    for (int view = 0; view < count; ++view) {
        const float2 step = steps[view];
        const int2 rows = sources(Y, Y, BACK.x, AHEAD.x, least, most, ny);
        int2 columns = sources(X, X, BACK.y, AHEAD.y, least, most, WIDE);
#ifdef LENSLETS
        columns = lenslets(columns, spacing, nx, wide);
#endif
        for (int y = rows.s0; y <= rows.s1; ++y)
            for (int x = columns.s0; x <= columns.s1; ++x) {
                const long at = SAMPLE(view, y, x);
                if (!IS_SEEN(at))
                    continue;
                LOOK_UP(d[(size_t)y * nx + x]);
                const float wy = i == Y ? 1.0f - b : down && i + 1 == Y ? b : 0.0f;
                const float wx = j == X ? 1.0f - a : right && j + 1 == X ? a : 0.0f;
                if (wy != 0.0f && wx != 0.0f)
                    sum += wy * wx * WHITE(at) * g[at + c];
            }
    }
    out[(size_t)Y * WIDE * COUNT + s] = sum;
#endif
}
