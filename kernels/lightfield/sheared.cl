/* Samples of one view, shifted by a constant and interpolated linearly, by vectors.
 *
 *   value(y, s)    = bilinear between the four samples about (y + whole.y + part.y, ...), where
 *                    positions outside the view repeat its nearest sample
 *   inside(y, s)   = share of these four, by their weights, that lies inside: 0 ... 1
 *
 * s = x channels + c is a sample of a row; whole and part are in pixels, 0 <= part < 1.
 *
 * Mapping of the kernels: axis 0 = samples, axis 1 = planes, axis 2 = y; -DROWS: axes 0 and 1
 * exchanged, so that planes share a row of the light field in cache.
 *
 * -DSAMPLE=uchar | ushort | half | float   storage type of the light field
 * -DLANES=1 | 4 | 8 | 16            samples of a vector
 * -DVECTORS=n                      vectors of an item
 * Included only.
 */
#ifndef CLPLEN_SHEARED
#define CLPLEN_SHEARED
#include "common.cl"
#include "stored.cl"

#ifdef ROWS
#define SAMPLE_AXIS 1
#else
#define SAMPLE_AXIS 0
#endif
#define EACH_VECTOR(j) _Pragma("unroll") for (int j = 0; j < VECTORS; ++j)
#if LANES == 1
typedef float vec;
#define LOAD(from) stored(from, 0)
#define LANE(v, k) (v)
#else
typedef JOIN(float, LANES) vec;
typedef struct __attribute__((packed)) { vec v; } loose_vec;
#define LOAD(from) stored_vec(from)
#define LANE(v, k) ((float *)&(v))[k]
#endif

typedef struct {
    int ny, nx, channels, n;      /* n = nx channels, samples of a row */
    __global const int2 *edge;    /* for any s: (nearest sample inside, pixel) */
} view_size;

/* Two rows of a view, moved by whole samples, and how to mix their samples. */
typedef struct {
    __global const SAMPLE *upper, *lower;
    int from;          /* index of s = 0 */
    float across, down;
    float share;       /* of the two rows that lies inside */
} view_rows;

/* Share of two taps at i and i + 1, weighted 1 - part and part, that lies in 0 ... n - 1. */
inline float share_of(const int i, const float part, const int n)
{
    return i >= 0 && i + 1 < n ? 1.0f : i == -1 ? part : i == n - 1 ? 1.0f - part : 0.0f;
}

inline int nearest(const int i, const int n)
{
    return i < 0 ? 0 : i < n ? i : n - 1;
}

/* Row y of the k-th view: place = (its number, whole.y, whole.x), part = (part.y, part.x, ...). */
inline view_rows moved(__global const SAMPLE *L, const int4 place, const float4 part, const int y,
                       const view_size size)
{
    view_rows rows;
    const int top = y + place.y;
    __global const SAMPLE *view = L + (size_t)place.x * size.ny * size.n;
    rows.upper = view + (size_t)nearest(top, size.ny) * size.n;
    rows.lower = view + (size_t)nearest(top + 1, size.ny) * size.n;
    rows.from = place.z * size.channels;
    rows.across = part.y;
    rows.down = part.x;
    rows.share = share_of(top, part.x, size.ny);
    return rows;
}

/* True if `count` samples from s on need no sample outside the view. */
inline bool within(const view_rows rows, const int s, const int count, const view_size size)
{
    return rows.from + s >= 0 && rows.from + s + size.channels + count <= size.n;
}

inline vec mixed(const view_rows rows, const vec a, const vec b, const vec c, const vec d)
{
    const vec above = a + rows.across * (b - a);
    const vec below = c + rows.across * (d - c);
    return above + rows.down * (below - above);
}

/* The value if no sample lies outside. */
inline vec value_within(const view_rows rows, const int s, const view_size size)
{
    __global const SAMPLE *a = rows.upper + rows.from + s, *c = rows.lower + rows.from + s;
    return mixed(rows, LOAD(a), LOAD(a + size.channels), LOAD(c), LOAD(c + size.channels));
}

inline vec value(const view_rows rows, const int s, const view_size size)
{
    if (within(rows, s, LANES, size))
        return value_within(rows, s, size);
    vec a, b, c, d;
    for (int k = 0; k < LANES; ++k) {
        const int left = size.edge[rows.from + s + k].x;
        const int right = size.edge[rows.from + s + k + size.channels].x;
        LANE(a, k) = stored(rows.upper, left);
        LANE(b, k) = stored(rows.upper, right);
        LANE(c, k) = stored(rows.lower, left);
        LANE(d, k) = stored(rows.lower, right);
    }
    return mixed(rows, a, b, c, d);
}

inline vec inside(const view_rows rows, const int s, const view_size size)
{
    if (within(rows, s, LANES, size))
        return (vec)(rows.share);
    vec out;
    for (int k = 0; k < LANES; ++k)
        LANE(out, k) = rows.share
                       * share_of(size.edge[rows.from + s + k].y, rows.across, size.nx);
    return out;
}

/* The lanes of a row of `n` samples from s on. */
inline void store_row(__global float *row, const vec v, const int s, const int n)
{
#if LANES > 1
    if (s + LANES <= n) {
        ((__global loose_vec *)(row + s))->v = v;
        return;
    }
#endif
    vec kept = v;
    for (int k = 0; k < min(LANES, n - s); ++k)
        row[s + k] = LANE(kept, k);
}

#endif
