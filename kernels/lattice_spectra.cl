/* Spectra of the fields of lattice.cl in a basis in which a mirror-symmetric projection is real.
 *
 * With A, B the spectra of the samples m and m' of a pair r, C = A + i B that of its field, pack
 * makes the rows
 *
 *   alpha = (A + B)/sqrt 2,  beta = (A - B)/(i sqrt 2)      (the middle sample: A alone)
 *
 * of frequencies q = (y, x) with 0 <= y <= ny/2, 0 <= x <= nx/2, sixteen to a block:
 *
 *   D[b, q / 16, plane rows + row, column, q % 16],  column = Re, Im at (y, x), Re, Im at (-y, x)
 *
 * where at (-y, x) the pairs are exchanged by the mirror y -> -y, beta with its sign. All of it is
 * orthogonal, so that the adjoint of a projection is its transpose. unpack is the inverse.
 *
 * assemble makes the matrix of a projection from the spectra of its point images, C[t, r] for the
 * voxel of pair t: with H = A and G = conj(B) = those of the voxel's mirror image,
 *
 *   alpha' = Re(H + G) alpha - Im(H - G) beta,   beta' = Im(H + G) alpha + Re(H - G) beta
 *
 *   R[q / 16, row of the picture, first + row of the volume, q % 16]
 *
 * With -DTURNED point images change their sign where pixels and voxels are turned by 180 degrees;
 * i times their spectra are those of a symmetric projection, and R is theirs.
 *
 * w, v: samples of a lenslet along an axis, of the picture and of the volume. Mapping of pack and
 * assemble: axis 0 = q with FOR_X, axis 1 = pair r, axis 2 = batch; of unpack: FOR_X over C.
 * -DROWS: see common.cl.
 */
#include "common.cl"

#define HALF_ROOT 0.70710678f
#define WIDTH 16

/* A and B at a frequency from C there and C at the opposite one. */
inline float4 parts(float2 c, float2 o)
{
    const float2 A = (float2)(c.x + o.x, c.y - o.y) / 2;
    const float2 B = (float2)(c.y + o.y, o.x - c.x) / 2;
    return (float4)(A, B);
}

/* The pair that the mirror y -> -y makes of r; -1 less it where it turns the pair round. */
inline int mirrored(int r, int w)
{
    const int t = (w - 1 - r / w) * w + r % w, last = w * w - 1;
    return t <= last - t ? t : -1 - (last - t);
}

/* (alpha, beta) of a pair. */
inline float4 rotated(float4 p)
{
    const float2 s = (p.xy + p.zw) * HALF_ROOT, d = (p.xy - p.zw) * HALF_ROOT;
    return (float4)(s, d.y, -d.x);
}

__kernel void pack(__global float *restrict D, __global const float2 *restrict C, const int w,
                   const int planes, const int ny, const int nx)
{
    const int r = get_global_id(1), batch = get_global_id(2), V = w * w, pairs = (V + 1) / 2;
    const int hx = nx / 2 + 1, count = (ny / 2 + 1) * hx, blocks = (count + WIDTH - 1) / WIDTH;
    const int turned = mirrored(r, w), s = turned < 0 ? -1 - turned : turned;
    const float sign = turned < 0 ? -1 : 1;
    const bool single = 2 * r == V - 1;
    const float scale = single ? HALF_ROOT : 1;
    __global const float2 *plus = C + row_start(batch * pairs + r, 0, ny, nx);
    __global const float2 *minus = C + row_start(batch * pairs + s, 0, ny, nx);
    FOR_X(q, blocks * WIDTH) {
        const size_t row = ((size_t)(batch / planes) * blocks + q / WIDTH) * planes * V +
                           (batch % planes) * V + 2 * r;
        __global float *to = D + row * 4 * WIDTH + q % WIDTH;
        float4 a = (float4)(0), b = (float4)(0);
        if (q < count) {
            const int y = q / hx, x = q % hx, oy = (ny - y) % ny, ox = (nx - x) % nx;
            a = rotated(parts(plus[y * nx + x], plus[oy * nx + ox]));
            b = rotated(parts(minus[oy * nx + x], minus[y * nx + ox]));
        }
        to[0] = scale * a.x;
        to[WIDTH] = scale * a.y;
        to[2 * WIDTH] = scale * b.x;
        to[3 * WIDTH] = scale * b.y;
        if (!single) {
            to[4 * WIDTH] = a.z;
            to[5 * WIDTH] = a.w;
            to[6 * WIDTH] = sign * b.z;
            to[7 * WIDTH] = sign * b.w;
        }
    }
}

__kernel void unpack(__global float2 *restrict C, __global const float *restrict D, const int w,
                     const int planes, const int ny, const int nx)
{
    const int y = get_global_id(1), batch = get_global_id(2), V = w * w, pairs = (V + 1) / 2;
    const int b = batch / pairs / planes, plane = batch / pairs % planes, r = batch % pairs;
    const int hx = nx / 2 + 1, blocks = ((ny / 2 + 1) * hx + WIDTH - 1) / WIDTH;
    const int turned = mirrored(r, w), s = turned < 0 ? -1 - turned : turned;
    const bool single = 2 * r == V - 1;
    const size_t to = row_start(batch, y, ny, nx);
    FOR_X(x, nx) {
        const bool far = x > nx / 2;
        const int fy = far ? (ny - y) % ny : y, fx = far ? nx - x : x;
        const bool below = fy > ny / 2;
        const int q = (below ? ny - fy : fy) * hx + fx;
        const size_t row = ((size_t)b * blocks + q / WIDTH) * planes * V + plane * V +
                           2 * (below ? s : r);
        __global const float *from = D + (row * 4 + (below ? 2 : 0)) * WIDTH + q % WIDTH;
        const float scale = single ? 1 : HALF_ROOT;
        const float2 alpha = (float2)(from[0], from[WIDTH]) * scale;
        const float sign = below && turned < 0 ? -scale : scale;
        float2 beta = (float2)(0, 0);
        if (!single)
            beta = (float2)(from[4 * WIDTH], from[5 * WIDTH]) * sign;
        float2 A = (float2)(alpha.x - beta.y, alpha.y + beta.x);
        float2 B = (float2)(alpha.x + beta.y, alpha.y - beta.x);
        if (far) {
            A.y = -A.y;
            B.y = -B.y;
        }
        C[to + x] = (float2)(A.x - B.y, A.y + B.x);
    }
}

__kernel void assemble(__global float *restrict R, __global const float2 *restrict C, const int w,
                       const int v, const int first, const int columns, const int ny, const int nx)
{
    const int r = get_global_id(1), t = get_global_id(2), V = w * w, pairs = (V + 1) / 2;
    const int hx = nx / 2 + 1, count = (ny / 2 + 1) * hx, blocks = (count + WIDTH - 1) / WIDTH;
    const bool middle = 2 * r == V - 1, centre = 2 * t == v * v - 1;
    const float scale = (middle ? HALF_ROOT : 1) * (centre ? HALF_ROOT : 1);
    __global const float2 *from = C + row_start(t * pairs + r, 0, ny, nx);
    FOR_X(q, blocks * WIDTH) {
        float4 p = (float4)(0);
        if (q < count) {
            const int y = q / hx, x = q % hx;
            p = scale * parts(from[y * nx + x], from[(ny - y) % ny * nx + (nx - x) % nx]);
#ifdef TURNED
            p = (float4)(-p.y, p.x, -p.w, p.z);
#endif
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
