/* Views of a scene of surfaces, and its disparity as the centre view sees it.
 *
 *   L[v, u, y, x, c] = gain[v, u] mean over the pixel of what its rays see,   (surfaces.cl)
 *   disparity[y, x]  = d of the surface that the ray through the pixel's centre sees
 *
 * 8 x 8 rays a pixel decide what is seen; where 3 x 3 rays over the pixel see one surface, one
 * does (what is thinner than half a pixel may lie between those). The brightness of a surface is
 * that of the pixel's centre ray at the mean d of the rays that see it: the texture is what pixels
 * see, averaged over them already, and so the same in every view.
 *
 * bounds[view, i]   rows y0 <= y <= y1 and columns x0 <= x <= x1 of the view that surface i is in
 *
 * Mapping: FOR_X of common.cl, batch = view. -DROWS: see common.cl.
 */
#include "surfaces.cl"

#define SIDE 8

/* Rays through a view (a, b), moved from (y, x) by (down, right). */
inline Rays beside(float4 ray, float8 down, float8 right)
{
    const Rays rays = {ray.x + down, ray.y + right, (float8)(ray.z), (float8)(ray.w)};
    return rays;
}

inline float sum_of(float8 lanes)
{
    const float4 pairs = lanes.lo + lanes.hi;
    return pairs.x + pairs.y + pairs.z + pairs.w;
}

/* Whether eight rays over the rim of a pixel see what its centre does. */
inline bool is_plain(const Scene *scene, ulong mask, float4 ray, int centre)
{
    const float8 down = (float8)(-0.5f, -0.5f, -0.5f, 0, 0, 0.5f, 0.5f, 0.5f);
    const float8 right = (float8)(-0.5f, 0, 0.5f, -0.5f, 0.5f, -0.5f, 0, 0.5f);
    float8 d;
    return !any(nearest(scene, mask, beside(ray, down, right), &d) != centre);
}

/* Brightness of a pixel whose rays see several surfaces: each by the number of its rays. */
inline void mixed(const Scene *scene, ulong mask, float4 ray, float background, float *sum)
{
    const float8 right = ((float8)(0, 1, 2, 3, 4, 5, 6, 7) - 3.5f) / SIDE;
    int8 seen[SIDE];
    float8 d[SIDE];
    for (int row = 0; row < SIDE; ++row)
        seen[row] = nearest(scene, mask, beside(ray, (row - 3.5f) / SIDE, right), d + row);
    int missed = SIDE * SIDE;
    while (mask) {
        const int i = 63 - (int)clz(mask);
        mask ^= (ulong)1 << i;
        int8 count = 0;
        float8 total = 0;
        for (int row = 0; row < SIDE; ++row) {
            count -= seen[row] == i;
            total += select((float8)(0), d[row], seen[row] == i);
        }
        const int rays = sum_of(convert_float8(count));
        if (rays)
            shine(scene, i, ray, sum_of(total) / rays, rays / (float)(SIDE * SIDE), sum);
        missed -= rays;
    }
    for (int c = 0; c < scene->channels; ++c)
        sum[c] += background * missed / (SIDE * SIDE);
}

__kernel void views(__global float *restrict out, __global const float *restrict shape,
                    __global const int *restrict which, __global const float4 *restrict edges,
                    __global const float *restrict spots, __global const float *restrict texels,
                    __global const int4 *restrict bounds, __global const float *restrict gain,
                    const float middle_v, const float middle_u, const float background,
                    const int view0, const int U, const int n, const int ny, const int nx,
                    const int channels)
{
    const Scene scene = {shape, which, edges, spots, texels, channels};
    const int view = view0 + get_global_id(2), y = get_global_id(1);
    __global const int4 *bound = bounds + view * n;
    __global float *line = out + row_start(get_global_id(2), y, ny, nx) * channels;
    ulong row = 0;
    for (int i = 0; i < n; ++i)
        row |= (ulong)(bound[i].x <= y && y <= bound[i].y) << i;
    FOR_X(x, nx) {
        ulong mask = 0;
        for (ulong rest = row; rest;) {
            const int i = 63 - (int)clz(rest);
            rest ^= (ulong)1 << i;
            mask |= (ulong)(bound[i].z <= x && x <= bound[i].w) << i;
        }
        const float4 ray = (float4)(y - 0.5f * (ny - 1), x - 0.5f * (nx - 1), view / U - middle_v,
                                    view % U - middle_u);
        float8 d;
        float sum[3] = {0, 0, 0};
        const int seen = nearest(&scene, mask, beside(ray, 0, 0), &d).s0;
        const bool alone = seen >= 0 && mask == (ulong)1 << seen && which[seen * WHICH + KIND] == PLANE
                           && which[seen * WHICH + OUTLINE] == WHOLE;
        if (!alone && !is_plain(&scene, mask, ray, seen))
            mixed(&scene, mask, ray, background, sum);
        else if (seen >= 0)
            shine(&scene, seen, ray, d.s0, 1, sum);
        else
            sum[0] = sum[1] = sum[2] = background;
        for (int c = 0; c < channels; ++c)
            line[x * channels + c] = gain[view] * sum[c];
    }
}

__kernel void truth(__global float *restrict disparity, __global int *restrict seen,
                    __global const float *restrict shape, __global const int *restrict which,
                    __global const float4 *restrict edges, const int n, const int ny, const int nx)
{
    const Scene scene = {shape, which, edges, 0, 0, 1};
    const int y = get_global_id(1);
    const ulong all = n < 64 ? ((ulong)1 << n) - 1 : ~(ulong)0;
    FOR_X(x, nx) {
        const float4 ray = (float4)(y - 0.5f * (ny - 1), x - 0.5f * (nx - 1), 0, 0);
        float8 d;
        const int found = nearest(&scene, all, beside(ray, 0, 0), &d).s0;
        seen[y * nx + x] = found;
        disparity[y * nx + x] = found < 0 ? NAN : d.s0;
    }
}
