/* Volumetric focus: the gain of a frequency hyperfan (Dansereau et al. 2013), in place.
 *
 *   F[v, u, ky, kx] *= exp(-s^2 / (2 sigma^2))
 *
 * s = distance of (fv, fu) from the segment { d (fy, fx), low <= d <= high } modulo 1, in cycles a
 * view: a light field of disparity d has its spectrum on (fv, fu) = d (fy, fx). Tables of
 * frequencies: fv[V], fu[U] in cycles a view, fy[ny] (times the ratio of disparities along y and
 * x), fx[nx] in cycles a pixel.
 *
 * Mapping: FOR_X over kx; axis 1 = ky, axis 2 = v U + u. -DROWS: see common.cl.
 */
#include "common.cl"

__kernel void hyperfan(__global float2 *restrict F, __global const float *restrict fv,
                       __global const float *restrict fu, __global const float *restrict fy,
                       __global const float *restrict fx, const float low, const float high,
                       const float half_over_variance, const int U, const int ny, const int nx)
{
    const int y = get_global_id(1), view = get_global_id(2);
    const size_t row = row_start(view, y, ny, nx);
    const float at_v = fv[view / U], at_u = fu[view % U];
    const float middle = (low + high) / 2;
    FOR_X(x, nx) {
        const float power = fy[y] * fy[y] + fx[x] * fx[x];
        const float dv = at_v - rint(at_v - middle * fy[y]);
        const float du = at_u - rint(at_u - middle * fx[x]);
        float nearest = INFINITY;
        for (int m = -1; m <= 1; ++m)
            for (int n = -1; n <= 1; ++n) {
                const float v = dv + m, u = du + n;
                const float along = v * fy[y] + u * fx[x];
                const float d = power > 0.0f ? clamp(along / power, low, high) : 0.0f;
                const float away_v = v - d * fy[y], away_u = u - d * fx[x];
                nearest = min(nearest, away_v * away_v + away_u * away_u);
            }
        F[row + x] *= exp(-nearest * half_over_variance);
    }
}
