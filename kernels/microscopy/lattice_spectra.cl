/* Spectra of the fields of lattice.cl in a basis in which a mirror-symmetric projection is real.
 *
 * With the spectra A, B of the samples m and m' of a pair r, and C = A + i B of its field, pack
 * computes the rows
 *
 *   alpha = (A + B)/sqrt 2,  beta = (A - B)/(i sqrt 2)      (the middle sample: A alone)
 *
 * of frequencies q = (y, x) with 0 <= y <= ny/2, 0 <= x <= nx/2, in blocks of sixteen:
 *
 *   D[b, q / 16, (plane parts + part) rows + row, column, q % 16],
 *       column = Re, Im at (y, x), Re, Im at (-y, x)
 *
 * At (-y, x) the mirror y -> -y exchanges the pairs, with a sign of beta. The transform is
 * orthogonal, so that the adjoint of a projection is its transpose. unpack is the inverse.
 *
 * An array without mirror symmetry has point images of several parts (cells.py). Each part has its
 * own real matrix, equal at (y, x) and (-y, x), and its own rows: the rows above times i (bit 0 of
 * the part) and negative at (-y, x) (bit 1). `bits` >> 2 p gives the bits of part p of `parts`.
 * unpack, the transpose of pack, sums over the parts.
 *
 * assemble computes the matrix of a projection from the spectra C[t - start, r] of the point image
 * of the voxel of pair t: with H = A and G = conj(B), the spectra of the voxel's mirror image,
 *
 *   alpha' = Re(H + G) alpha - Im(H - G) beta,   beta' = Im(H + G) alpha + Re(H - G) beta
 *
 *   R[q / 16, row of the picture, first + row of the volume, q % 16]
 *
 * A and B are divided by i if `odd`, for a part with bit 0. wy, wx: samples of a lenslet, or cell, of
 * a picture or volume; V, W: their products for the picture and the volume. Mapping of pack and
 * assemble: axis 0 = q with FOR_X, axis 1 = pair r, axis 2 = batch; of unpack: FOR_X over C.
 * -DROWS: see common.cl.
 */
#include "common.cl"

#define HALF_ROOT 0.70710678f
#define WIDTH 16

/* A and B at a frequency from C at this and at the opposite frequency. */
inline float4 parts_of(float2 c, float2 o)
{
    const float2 A = (float2)(c.x + o.x, c.y - o.y) / 2;
    const float2 B = (float2)(c.y + o.y, o.x - c.x) / 2;
    return (float4)(A, B);
}

/* The mirror image s of pair r under y -> -y, or -1 - s if it also reverses the pair. */
inline int mirrored(int r, int wy, int wx)
{
    const int t = (wy - 1 - r / wx) * wx + r % wx, last = wy * wx - 1;
    return t <= last - t ? t : -1 - (last - t);
}

/* (alpha, beta) of a pair. */
inline float4 rotated(float4 p)
{
    const float2 s = (p.xy + p.zw) * HALF_ROOT, d = (p.xy - p.zw) * HALF_ROOT;
    return (float4)(s, d.y, -d.x);
}

/* Store a row of four columns of a part. */
inline void store(__global float *to, float4 value, int part)
{
    const float below = part & 2 ? -1 : 1;
    if (part & 1)
        value = (float4)(-value.y, value.x, -value.w, value.z);
    to[0] = value.x;
    to[WIDTH] = value.y;
    to[2 * WIDTH] = below * value.z;
    to[3 * WIDTH] = below * value.w;
}

/* The transpose of `store`, for two of the columns. */
inline float2 load(__global const float *from, int part, bool below)
{
    float2 value = (float2)(from[0], from[WIDTH]);
    if (part & 1)
        value = (float2)(value.y, -value.x);
    return part & 2 && below ? -value : value;
}

__kernel void pack(__global float *restrict D, __global const float2 *restrict C, const int wy,
                   const int wx, const int planes, const int parts, const int bits, const int ny,
                   const int nx)
{
    const int r = get_global_id(1), batch = get_global_id(2), V = wy * wx, pairs = (V + 1) / 2;
    const int hx = nx / 2 + 1, count = (ny / 2 + 1) * hx, blocks = (count + WIDTH - 1) / WIDTH;
    const int turned = mirrored(r, wy, wx), s = turned < 0 ? -1 - turned : turned;
    const float sign = turned < 0 ? -1 : 1;
    const bool single = 2 * r == V - 1;
    const float scale = single ? HALF_ROOT : 1;
    __global const float2 *plus = C + row_start(batch * pairs + r, 0, ny, nx);
    __global const float2 *minus = C + row_start(batch * pairs + s, 0, ny, nx);
    FOR_X(q, blocks * WIDTH) {
        const size_t row = (((size_t)(batch / planes) * blocks + q / WIDTH) * planes +
                            batch % planes) * parts * V + 2 * r;
        __global float *to = D + row * 4 * WIDTH + q % WIDTH;
        float4 a = (float4)(0), b = (float4)(0);
        if (q < count) {
            const int y = q / hx, x = q % hx, oy = (ny - y) % ny, ox = (nx - x) % nx;
            a = rotated(parts_of(plus[y * nx + x], plus[oy * nx + ox]));
            b = rotated(parts_of(minus[oy * nx + x], minus[y * nx + ox]));
        }
        for (int p = 0; p < parts; ++p, to += (size_t)V * 4 * WIDTH) {
            const int part = bits >> 2 * p & 3;
            store(to, scale * (float4)(a.xy, b.xy), part);
            if (!single)
                store(to + 4 * WIDTH, (float4)(a.zw, sign * b.zw), part);
        }
    }
}

/* alpha and beta of a pair at a frequency, summed over its parts, which are `apart` numbers apart. */
inline float4 summed(__global const float *from, const int parts, const int bits, const size_t apart,
                     const float scale, const float sign, const bool below)
{
    float4 sum = (float4)(0);
    for (int p = 0; p < parts; ++p, from += apart) {
        const int part = bits >> 2 * p & 3;
        sum.xy += load(from, part, below) * scale;
        if (sign != 0)
            sum.zw += load(from + 4 * WIDTH, part, below) * sign;
    }
    return sum;
}

/* C of a pair at a frequency from its alpha and beta; far: from those of the opposite frequency. */
inline float2 unpacked(const float4 sum, const bool far)
{
    const float2 A = (float2)(sum.x - sum.w, sum.y + sum.z);
    const float2 B = (float2)(sum.x + sum.w, sum.y - sum.z);
    return far ? (float2)(A.x + B.y, B.x - A.y) : (float2)(A.x - B.y, A.y + B.x);
}

__kernel void unpack(__global float2 *restrict C, __global const float *restrict D, const int wy,
                     const int wx, const int planes, const int parts, const int bits, const int ny,
                     const int nx)
{
    const int y = get_global_id(1), batch = get_global_id(2), V = wy * wx, pairs = (V + 1) / 2;
    const int b = batch / pairs / planes, plane = batch / pairs % planes, r = batch % pairs;
    const int hx = nx / 2 + 1, blocks = ((ny / 2 + 1) * hx + WIDTH - 1) / WIDTH;
    const int turned = mirrored(r, wy, wx), s = turned < 0 ? -1 - turned : turned;
    const bool single = 2 * r == V - 1;
    const float scale = single ? 1 : HALF_ROOT;
    const size_t to = row_start(batch, y, ny, nx), apart = (size_t)planes * parts * V * 4 * WIDTH;
    for (int side = 0; side < 2; ++side) { /* columns 0 to nx/2, then the others */
        const bool far = side;
        const int fy = far ? (ny - y) % ny : y;
        const bool below = fy > ny / 2;
        const float sign = single ? 0 : below && turned < 0 ? -scale : scale;
        const int first = (below ? ny - fy : fy) * hx;
        const size_t row = ((size_t)b * blocks * planes + plane) * parts * V + 2 * (below ? s : r);
        __global const float *from = D + (row * 4 + (below ? 2 : 0)) * WIDTH;
        const int start = far ? hx : 0, stop = far ? nx : hx;
#ifdef ROWS
        for (int x = start; x < stop; ++x) {
#else
        const int x = get_global_id(0);
        if (x >= start && x < stop) {
#endif
            const int q = first + (far ? nx - x : x);
            __global const float *at = from + q / WIDTH * apart + q % WIDTH;
            C[to + x] = unpacked(
                summed(at, parts, bits, (size_t)V * 4 * WIDTH, scale, sign, below), far);
        }
    }
}

__kernel void assemble(__global float *restrict R, __global const float2 *restrict C,
                       const int start, const int V, const int W, const int first,
                       const int columns, const int odd, const int ny, const int nx)
{
    const int r = get_global_id(1), place = get_global_id(2), t = start + place;
    const int pairs = (V + 1) / 2;
    const int hx = nx / 2 + 1, count = (ny / 2 + 1) * hx, blocks = (count + WIDTH - 1) / WIDTH;
    const bool middle = 2 * r == V - 1, centre = 2 * t == W - 1;
    const float scale = (middle ? HALF_ROOT : 1) * (centre ? HALF_ROOT : 1);
    __global const float2 *from = C + row_start(place * pairs + r, 0, ny, nx);
    FOR_X(q, blocks * WIDTH) {
        float4 p = (float4)(0);
        if (q < count) {
            const int y = q / hx, x = q % hx;
            p = scale * parts_of(from[y * nx + x], from[(ny - y) % ny * nx + (nx - x) % nx]);
            if (odd)
                p = (float4)(p.y, -p.x, p.w, -p.z);
        }
        const size_t row = ((size_t)(q / WIDTH) * V + 2 * r) * columns + first + 2 * t;
        __global float *to = R + row * WIDTH + q % WIDTH;
        to[0] = p.x + p.z;
        if (!centre)
            to[WIDTH] = -(p.y + p.w);
        if (!middle)
            to[columns * WIDTH] = p.y - p.w;
        if (!middle && !centre)
            to[(columns + 1) * WIDTH] = p.x - p.z;
    }
}
