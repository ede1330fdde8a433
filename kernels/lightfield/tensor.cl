/* Structure tensor of epipolar-plane images (Bigun and Granlund 1987; Wanner and Goldluecke 2012).
 *
 * The light field is sheared by a plane d0 (sheared.cl), so a point of disparity d moves by
 * d - d0 pixels a view step. For neighbours m and n along a row of views, D view steps apart,
 *
 *   Lx = (g_m + g_n)/2,     g = (l(+1) - l(-1))/2                        along the axis of the views,
 *   Lu = (h_n - h_m)/D,     h = (l(-1) + 4 l(0) + l(+1))/6
 *   epi_tensor   J[y, s] = sum_mn w_m w_n c_m c_n (Lx Lx, Lx Lu, Lu Lu),   c = share inside
 *
 * g and h have the same gain for d - d0 -> 0 up to the fourth power of the frequency:
 * Lu = (d - d0) Lx. A gradient below 1e-5 of the sample is rounding and is set to 0.
 *
 * place[n] = (view, integer shift along y, along x, 0);  part[n] = (their fractions, w_n, 1/D); the
 * views 2 n and 2 n + 1 are a pair.
 * Mapping: epi_tensor: an item = LANES VECTORS samples of a row, in the order of
 * sheared.cl.
 * -DSAMPLE=uchar | ushort | half | float, -DLANES=1 | 4 | 8 | 16, -DVECTORS=n: see sheared.cl. -DROWS.
 */
#include "sheared.cl"

#define ROUNDING 1e-10f

typedef struct { vec smooth, slope; } gradient;

/* g and h at sample s of a view whose rows y - down, y, y + down are given; `within`: all samples
 * lie inside the view. */
inline gradient along(const view_rows rows[3], const int s, const int right, const view_size size,
                      const bool within)
{
    const vec a = within ? value_within(rows[0], s - right, size) : value(rows[0], s - right, size);
    const vec b = within ? value_within(rows[1], s, size) : value(rows[1], s, size);
    const vec c = within ? value_within(rows[2], s + right, size) : value(rows[2], s + right, size);
    gradient out;
    out.smooth = (a + c + 4 * b) * (1 / 6.0f);
    out.slope = 0.5f * (c - a);
    return out;
}

/* The products of one pair of views, added to the sums. `all_within`: of every vector. */
inline void add_pair(vec xx[VECTORS], vec xu[VECTORS], vec uu[VECTORS], const view_rows m[3],
                     const view_rows n[3], const float weight, const float link, const int s,
                     const int right, const view_size size, const bool all_within)
{
    for (int j = 0; j < VECTORS; ++j) { /* not unrolled, which is 1.5 times as fast */
        const int i = s + LANES * j, count = LANES + 2 * right;
        const bool here = all_within || (within(m[1], i - right, count, size)
                                         && within(n[1], i - right, count, size));
        const gradient a = here ? along(m, i, right, size, true) : along(m, i, right, size, false);
        const gradient b = here ? along(n, i, right, size, true) : along(n, i, right, size, false);
        const vec share = here ? (vec)(m[1].share * n[1].share)
                               : inside(m[1], i, size) * inside(n[1], i, size);
        const vec w = weight * share;
        const vec mean = 0.5f * (a.slope + b.slope);
        const vec Lx = mean * mean > ROUNDING * a.smooth * a.smooth ? mean : (vec)(0.0f);
        const vec Lu = (b.smooth - a.smooth) * link;
        xx[j] += w * Lx * Lx;
        xu[j] += w * Lx * Lu;
        uu[j] += w * Lu * Lu;
    }
}

#define THREE_ROWS(n) { moved(L, place[n], part[n], y - down, size), \
                        moved(L, place[n], part[n], y, size), \
                        moved(L, place[n], part[n], y + down, size) }

__kernel void epi_tensor(__global float *restrict J, __global const SAMPLE *restrict L,
                         __global const int4 *restrict place, __global const float4 *restrict part,
                         const int pairs, const int down, const int first,
                         __global const int2 *restrict edge, const int reach, const int ny,
                         const int nx, const int channels)
{
    const view_size size = {ny, nx, channels, nx * channels, edge + reach};
    const int y = get_global_id(2);
    const int s = get_global_id(SAMPLE_AXIS) * LANES * VECTORS;
    const int right = down ? 0 : channels;
    if (s >= size.n)
        return;
    vec xx[VECTORS], xu[VECTORS], uu[VECTORS];
    EACH_VECTOR(j)
        xx[j] = xu[j] = uu[j] = (vec)(0.0f);
    for (int k = 0; k < pairs; ++k) {
        const view_rows m[3] = THREE_ROWS(2 * k), n[3] = THREE_ROWS(2 * k + 1);
        const float weight = part[2 * k].z * part[2 * k + 1].z, link = part[2 * k].w;
        const int count = LANES * VECTORS + 2 * right;
        if (within(m[1], s - right, count, size) && within(n[1], s - right, count, size))
            add_pair(xx, xu, uu, m, n, weight, link, s, right, size, true);
        else
            add_pair(xx, xu, uu, m, n, weight, link, s, right, size, false);
    }
    EACH_VECTOR(j) {
        store_row(J + row_start(first, y, ny, size.n), xx[j], s + LANES * j, size.n);
        store_row(J + row_start(first + 1, y, ny, size.n), xu[j], s + LANES * j, size.n);
        store_row(J + row_start(first + 2, y, ny, size.n), uu[j], s + LANES * j, size.n);
    }
}
