/* Detail of views: the difference to a smoothing window, as 16-bit integers.
 *
 *   out[k, y, x, c] = 2^15 + rint(scale[k] (L[k, y, x, c] - sum_s sum_t w[|s|] w[|t|] L[k, y + s, x + t, c])),
 *   -radius <= s, t <= radius, clamped to 0 ... 2^16 - 1
 *
 * Beyond the edges the view is reflected.
 * Mapping: a group of items owns `length` samples, whole pixels, of LINES rows (separated.cl), axis
 * 1 = y / LINES, axis 2 = k, a view. -DSAMPLE=uchar | ushort | half | float, -DCHANNELS=n, -DLINES=n,
 * -DLANES=4 | 8 | 16; -DROWS: the group is one item.
 */
#include "separated.cl"

#define MIDDLE 32768.0f

inline ushort stored_detail(const float value)
{
    return (ushort)clamp(rint(value) + MIDDLE, 0.0f, 2 * MIDDLE - 1);
}

#ifdef ROWS
typedef struct __attribute__((packed)) { JOIN(ushort, LANES) v; } loose_detail;

/* Likewise for a vector: adding 1.5 2^23 rounds to integers in the last bits. */
inline void store_detail(__global ushort *to, const vec value)
{
    const vec low = (vec)(-MIDDLE), high = (vec)(MIDDLE - 1);
    vec bound = value > low ? value : low;
    bound = bound < high ? bound : high;
    const ivec whole = JOIN(as_int, LANES)(bound + (vec)(12582912.0f));
    ((__global loose_detail *)to)->v
        = JOIN(convert_ushort, LANES)((whole ^ (ivec)(0x8000)) & (ivec)(0xffff));
}
#endif

__kernel void view_detail(__global ushort *restrict out, __global const SAMPLE *restrict L,
                          __global const float *restrict w, __global const float *restrict scale,
                          const int radius, const int ny, const int nx, const int length,
                          __local float *line)
{
    const int y = get_global_id(1) * LINES, k = get_global_id(2);
    const int n = nx * CHANNELS, halo = radius * CHANNELS;
    const int first = get_group_id(0) * length;
    const int count = min(length, n - first), apart = length + 2 * halo;
    const size_t start = row_start(k, y, ny, n) + first;
    w += radius + LINES - 1;
    columns(line, apart, L + row_start(k, 0, ny, n), y, first, count, halo, w, radius, ny, nx,
            CHANNELS);
    barrier(CLK_LOCAL_MEM_FENCE);
    out += start;
    L += start;
    line += halo;
    for (int r = 0; r < min(LINES, ny - y); ++r, out += n, L += n, line += apart) {
#ifdef ROWS
        vec low[VECTORS];
        FOR_CHUNKS(i, 0, count, CHUNK) {
            across_chunk(low, line + i, w, radius, CHANNELS);
            UNROLLED(j)
                store_detail(out + i + LANES * j,
                             (vec)(scale[k]) * (stored_vec(L + i + LANES * j) - low[j]));
        }
        if (count >= CHUNK)
            continue;
#endif
        FOR_ITEMS(i, count)
            out[i] = stored_detail(scale[k] * (stored(L, i) - across(line + i, w, radius, CHANNELS)));
    }
}
