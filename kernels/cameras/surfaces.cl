/* Surfaces in the space (Y, X, d) of the centre view, and what a ray sees of them.
 *
 * A ray of the light field is the straight line (Y, X) = (y + d a, x + d b) for all d, with (y, x)
 * its place in the view and (a, b) = (v - vc, u - uc): the light field's law
 * L[v, u](y - d a, x - d b) = C(y, x) read as geometry. The surface of the largest d on it is seen.
 *
 *   plane       d = d0 + gy Y + gx X       d = (d0 + gy y + gx x)/(1 - gy a - gx b) on the ray
 *   ellipsoid   (d - d0)^2/h^2 + ((Y - cy)^2 + (X - cx)^2)/R^2 = 1, the larger root on the ray
 *   outline     of a plane, in (Y, X): ellipse, polygon (even-odd rule), bars that may taper
 *   brightness  T(Y, X) (1 + sy Y + sx X) + spots; T a periodic cubic B-spline of its table
 *   spot        strength exp(-r^2/(2 w^2)) about a centre of a disparity of its own (a highlight)
 *
 * A bit of a mask stands for a surface: 64 at most. Tables: SHAPE floats and WHICH ints a surface
 * (names below), edges (y0, x0, y1, x1) of polygons, five floats a spot.
 */
#include "common.cl"

#define SHAPE 17
#define WHICH 9
#define NOTHING -1e30f

enum { D0, GY, GX, CY, CX, COS, SIN, RY, RX, PERIOD, HALF0, HALF1, PER_PIXEL, OY, OX, SHADE_Y, SHADE_X };
enum { KIND, OUTLINE, EDGE, EDGES, TEXTURE, NY, NX, SPOT, SPOTS };
enum { PLANE, SPHERE };
enum { WHOLE, ELLIPSE, POLYGON, BARS };

/* Eight lines through the scene. */
typedef struct { float8 y, x, a, b; } Rays;

/* All tables of a scene. */
typedef struct {
    __global const float *shape;
    __global const int *which;
    __global const float4 *edges;
    __global const float *spots;
    __global const float *texels;
    int channels;
} Scene;

inline int8 in_polygon(__global const float4 *edge, int count, float8 Y, float8 X)
{
    int8 inside = 0;
    for (int k = 0; k < count; ++k) {
        const float4 e = edge[k];
        const int8 crosses = (e.x > Y) ^ (e.z > Y);
        inside ^= crosses & (X < e.y + (Y - e.x) * ((e.w - e.y) / (e.z - e.x)));
    }
    return inside;
}

inline int8 in_outline(const Scene *scene, int i, float8 Y, float8 X)
{
    __global const float *s = scene->shape + i * SHAPE;
    __global const int *w = scene->which + i * WHICH;
    if (w[OUTLINE] == POLYGON)
        return in_polygon(scene->edges + w[EDGE], w[EDGES], Y, X);
    const float8 dy = Y - s[CY], dx = X - s[CX];
    const float8 along = s[COS] * dy + s[SIN] * dx, across = s[COS] * dx - s[SIN] * dy;
    if (w[OUTLINE] == ELLIPSE) {
        const float8 p = along / s[RY], q = across / s[RX];
        return p * p + q * q <= 1;
    }
    const float8 from = across + s[RX];
    const float8 off = from - (floor(from / s[PERIOD]) + 0.5f) * s[PERIOD];
    const float8 half_width = s[HALF0] + (s[HALF1] - s[HALF0]) * ((along + s[RY]) / (2 * s[RY]));
    return (fabs(along) <= s[RY]) & (fabs(across) <= s[RX]) & (fabs(off) <= half_width);
}

/* The disparity at which each ray meets surface i first, NOTHING where it does not. */
inline float8 meet(const Scene *scene, int i, Rays ray)
{
    __global const float *s = scene->shape + i * SHAPE;
    const float8 nothing = NOTHING;
    if (scene->which[i * WHICH + KIND] == PLANE) {
        const float8 d = (s[D0] + s[GY] * ray.y + s[GX] * ray.x) / (1 - s[GY] * ray.a - s[GX] * ray.b);
        if (scene->which[i * WHICH + OUTLINE] == WHOLE)
            return d;
        return select(nothing, d, in_outline(scene, i, ray.y + d * ray.a, ray.x + d * ray.b));
    }
    const float steep = s[GY] / s[GX];
    const float8 qy = (ray.y - s[CY] + s[D0] * ray.a) / s[GX];
    const float8 qx = (ray.x - s[CX] + s[D0] * ray.b) / s[GX];
    const float8 p = 1 + steep * steep * (ray.a * ray.a + ray.b * ray.b);
    const float8 q = steep * (qy * ray.a + qx * ray.b);
    const float8 root = q * q - p * (qy * qy + qx * qx - 1);
    return select(nothing, s[D0] + s[GY] * (sqrt(fmax(root, 0)) - q) / p, root >= 0);
}

/* The surface of a mask that each ray sees, -1 if none, and where. */
inline int8 nearest(const Scene *scene, ulong mask, Rays ray, float8 *d)
{
    int8 found = -1;
    *d = NOTHING;
    while (mask) {
        const int i = 63 - (int)clz(mask);
        mask ^= (ulong)1 << i;
        const float8 here = meet(scene, i, ray);
        found = select(found, (int8)i, here > *d);
        *d = fmax(*d, here);
    }
    return found;
}

inline float4 spline(float t)
{
    const float s = 1 - t;
    return (float4)(s * s * s, 4 - 3 * t * t * (1 + s), 4 - 3 * s * s * (1 + t), t * t * t) / 6;
}

inline int wrapped(int i, int n)
{
    const int rest = i % n;
    return rest < 0 ? rest + n : rest;
}

/* Add `share` of the brightness of surface i where the ray (y, x, a, b) meets it, at d, to each
 * channel. */
inline void shine(const Scene *scene, int i, float4 ray, float d, float share, float *sum)
{
    __global const float *s = scene->shape + i * SHAPE;
    __global const int *w = scene->which + i * WHICH;
    const float Y = ray.x + d * ray.z, X = ray.y + d * ray.w;
    const float ty = Y * s[PER_PIXEL] + s[OY], tx = X * s[PER_PIXEL] + s[OX];
    const float fy = floor(ty), fx = floor(tx);
    const float4 wy4 = spline(ty - fy), wx4 = spline(tx - fx);
    const float wy[4] = {wy4.x, wy4.y, wy4.z, wy4.w}, wx[4] = {wx4.x, wx4.y, wx4.z, wx4.w};
    const int channels = scene->channels;
    const float light = share * fmax(0.0f, 1 + s[SHADE_Y] * Y + s[SHADE_X] * X);
    int row = wrapped((int)fy - 1, w[NY]);
    const int column = wrapped((int)fx - 1, w[NX]);
    for (int j = 0; j < 4; ++j, row = row + 1 < w[NY] ? row + 1 : 0) {
        __global const float *line = scene->texels + w[TEXTURE] + row * w[NX] * channels;
        for (int k = 0, at = column; k < 4; ++k, at = at + 1 < w[NX] ? at + 1 : 0)
            for (int c = 0; c < channels; ++c)
                sum[c] += light * wy[j] * wx[k] * line[at * channels + c];
    }
    for (int k = w[SPOT]; k < w[SPOT] + w[SPOTS]; ++k) {
        __global const float *spot = scene->spots + 5 * k;
        const float y = ray.x + spot[4] * ray.z - spot[0], x = ray.y + spot[4] * ray.w - spot[1];
        const float glow = share * spot[3] * exp(-(y * y + x * x) * spot[2]);
        for (int c = 0; c < channels; ++c)
            sum[c] += glow;
    }
}
