/* What a plenoptic camera records of a scene of surfaces, by geometrical rays.
 *
 * The ray from u on the main lens through x on the array, under lenslet k at x_k, meets the sensor
 * at s = z3 (x - u)/z2 - (x - x_k) z3/f from x (with a field lens at -z3 u/z2 - ...). Turned round,
 * the pixel at e from the centre of the sub-image of lenslet k, x_k (1 + z3/z2), sees with
 * xi = x - x_k and |du| = pixel z2/z3
 *
 *   u = g xi - z2 e/z3,  g = 1 + z2/z3 - z2/f     and as a view   b = -u/|du| = e/pixel - g xi/|du|
 *
 * g = 1 for a 1.0 camera (z3 = f), -F/a for a 2.0 camera (1/a + 1/z3 = 1/f, z2 = F + a); with a field
 * lens less by 1. blur[kind] is g over |du|, in steps of the views for a pitch of rows and columns;
 * kinds as in lens_types.cl. widest is the largest of them.
 *   raw = sum over lenslets of the mean over the pixel and the lenslet of what rays see,  (surfaces.cl)
 *         0 where they miss the main lens, a^2 + b^2 > radius^2
 *
 * A pixel lies at (row, column) = row_at[y] + column_at[x] + row_part[y] + column_part[x] in
 * sub-images from the first one, each a pair (along rows' normal, along rows), split into whole and
 * part. samples[j] = (xi_y, xi_x, eta_y, eta_x): place in the lenslet, in pitches of rows and
 * columns, and in the pixel, in pixels; a multiple of eight of them.
 *
 * -DADJOINT: the transpose of raw as a map of the textures' coefficients: out are pixels that are
 * read, and what each coefficient counts is added to texels as a whole number of 64 bits, low word
 * first, so that sums do not depend on their order: pixels are scaled by the caller.
 *
 * bounds[i]   rows y0 <= k <= y1 and columns x0 <= k <= x1 of lenslets that see surface i
 *
 * Mapping: FOR_X of common.cl. -DROWS: see common.cl. -DHEXAGONAL, -DTYPES=, -DTYPE_STEP=: see
 * lens_types.cl.
 */
#include "lens_types.cl"
#include "surfaces.cl"

#ifdef ADJOINT
#define PIXELS __global const float
#define TEXELS volatile __global uint
#else
#define PIXELS __global float
#define TEXELS __global const float
#endif

#ifdef ADJOINT
/* Add term, rounded, to a whole number of 64 bits, whoever else adds to it. */
inline void add_whole(volatile __global uint *to, float term)
{
    const ulong whole = as_ulong(convert_long_rte(term));
    const uint low = (uint)whole, before = atomic_add(to, low);
    const uint carry = (uint)(before + low) < before;
    atomic_add(to + 1, (uint)(whole >> 32) + carry);
}

/* The transpose of `shine` as a map of the coefficients: `share` of them where the ray (y, x, a, b)
 * meets surface i at d. */
inline void gather(const Scene *scene, int i, float4 ray, float d, float share,
                   volatile __global uint *texels)
{
    __global const float *s = scene->shape + i * SHAPE;
    __global const int *w = scene->which + i * WHICH;
    const float Y = ray.x + d * ray.z, X = ray.y + d * ray.w;
    const float ty = Y * s[PER_PIXEL] + s[OY], tx = X * s[PER_PIXEL] + s[OX];
    const float fy = floor(ty), fx = floor(tx);
    const float4 wy4 = spline(ty - fy), wx4 = spline(tx - fx);
    const float wy[4] = {wy4.x, wy4.y, wy4.z, wy4.w}, wx[4] = {wx4.x, wx4.y, wx4.z, wx4.w};
    const float light = share * fmax(0.0f, 1 + s[SHADE_Y] * Y + s[SHADE_X] * X);
    for (int j = 0; j < 4; ++j)
        for (int k = 0; k < 4; ++k) {
            const int row = wrapped((int)fy - 1 + j, w[NY]), at = wrapped((int)fx - 1 + k, w[NX]);
            for (int c = 0; c < scene->channels; ++c)
                add_whole(texels + 2 * (w[TEXTURE] + (row * w[NX] + at) * scene->channels + c),
                          light * wy[j] * wx[k]);
        }
}
#endif

/* Sum over the samples of what lenslet (i, k) shows at (down, right) pixels from its sub-image. */
inline float lenslet(const Scene *scene, ulong mask, __global const float4 *samples, int count,
                     float2 place, float2 at, float2 blur, float radius, float aspect,
                     float background, float weight, TEXELS *texels)
{
    float sum = 0;
    for (int j = 0; j < count; j += 8) {
        union { float8 lanes; float lane[8]; } y, x, a, b, d;
        union { int8 lanes; int lane[8]; } seen;
        for (int k = 0; k < 8; ++k) {
            const float4 sample = samples[j + k];
            y.lane[k] = place.x + sample.x;
            x.lane[k] = place.y + sample.y;
            a.lane[k] = at.x + sample.z - sample.x * blur.x;
            b.lane[k] = at.y + sample.w - sample.y * blur.y;
        }
        const int8 passes = a.lanes * a.lanes + b.lanes * b.lanes <= radius * radius;
        if (!any(passes))
            continue;
        a.lanes *= aspect;
        const Rays rays = {y.lanes, x.lanes, a.lanes, b.lanes};
        seen.lanes = nearest(scene, mask, rays, &d.lanes);
        seen.lanes = select((int8)(-2), seen.lanes, passes);
#ifdef ADJOINT
        for (int k = 0; k < 8; ++k)
            if (seen.lane[k] >= 0)
                gather(scene, seen.lane[k], (float4)(y.lane[k], x.lane[k], a.lane[k], b.lane[k]),
                       d.lane[k], weight / (count * scene->channels), texels);
#else
        for (int k = 0; k < 8; ++k) {
            float light[3] = {0, 0, 0};
            if (seen.lane[k] >= 0)
                shine(scene, seen.lane[k], (float4)(y.lane[k], x.lane[k], a.lane[k], b.lane[k]),
                      d.lane[k], 1, light);
            else if (seen.lane[k] == -1)
                light[0] = background * scene->channels;
            sum += light[0] + light[1] + light[2];
        }
#endif
    }
    return sum / (count * scene->channels);
}

__kernel void expose(PIXELS *restrict out, __global const float *restrict shape,
                     __global const int *restrict which, __global const float4 *restrict edges,
                     __global const float *restrict spots, TEXELS *texels,
                     __global const int4 *restrict bounds, __global const int2 *restrict row_at,
                     __global const float2 *restrict row_part, __global const int2 *restrict column_at,
                     __global const float2 *restrict column_part, __global const float4 *restrict samples,
                     const float2 size, __global const float2 *restrict blur,
                     const float2 widest, const float radius, const float aspect,
                     const float odd_shift, const float background, const int reach,
                     const int count, const int rows, const int columns, const int n, const int ny,
                     const int nx, const int channels)
{
#ifdef ADJOINT
    const Scene scene = {shape, which, edges, spots, 0, channels};
#else
    const Scene scene = {shape, which, edges, spots, texels, channels};
#endif
    const int y = get_global_id(1);
    const float2 limit = radius + 1 + widest;
    FOR_X(x, nx) {
        const float2 part = row_part[y] + column_part[x];
        const int2 near = row_at[y] + column_at[x] + convert_int2(rint(part));
        const float2 rest = part - rint(part);
#ifdef ADJOINT
        const float weight = out[y * nx + x];
#else
        const float weight = 1;
#endif
        float sum = 0;
        for (int i = max(0, near.x - reach); i <= min(rows - 1, near.x + reach); ++i) {
            const float shift = (i & 1) * odd_shift;
            for (int k = max(0, near.y - reach); k <= min(columns - 1, near.y + reach); ++k) {
                const float2 at = (rest + (float2)(near.x - i, near.y - k - shift)) * size;
                if (fabs(at.x) > limit.x || fabs(at.y) > limit.y)
                    continue;
                ulong mask = 0;
                for (int one = 0; one < n; ++one)
                    mask |= (ulong)(bounds[one].x <= i && i <= bounds[one].y && bounds[one].z <= k
                                    && k <= bounds[one].w) << one;
                const float2 place = {i - 0.5f * (rows - 1), k + shift - 0.5f * (columns - 1)};
                sum += lenslet(&scene, mask, samples, count, place, at, blur[lens_type(i, k)], radius,
                               aspect, background, weight, texels);
            }
        }
#ifndef ADJOINT
        out[y * nx + x] = sum;
#endif
    }
}
