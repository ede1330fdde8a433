/* Volumetric focus: the gain of a frequency hyperfan (Dansereau et al. 2013), in place.
 *
 *   F[v, u, ky, kx] *= exp(-s^2 half_over_variance)
 *
 * s = distance of (fv, fu) from the segment { d (fy, fx), -reach <= d <= reach } modulo 1, in
 * cycles a view: a light field of disparity d has its spectrum on (fv, fu) = d (fy, fx). Tables of
 * frequencies, of magnitude 1/2 at most: fv[V], fu[U] in cycles a view, fx[nx] in cycles a pixel,
 * fy[ny] likewise times the ratio of disparities along y and x.
 *
 * Mapping: FOR_X over kx; axis 1 = ky, axis 2 = v U + u. -DROWS: see common.cl.
 */
#include "common.cl"

__kernel void hyperfan(__global float2 *restrict F, __global const float *restrict fv,
                       __global const float *restrict fu, __global const float *restrict fy,
                       __global const float *restrict fx, const float reach,
                       const float half_over_variance, const int U, const int ny, const int nx)
{
    const int y = get_global_id(1), view = get_global_id(2);
    const size_t row = row_start(view, y, ny, nx);
    FOR_X(x, nx) {
        const float power = fy[y] * fy[y] + fx[x] * fx[x];
        float nearest = INFINITY;
        for (int m = -1; m <= 1; ++m)
            for (int n = -1; n <= 1; ++n) {
                const float v = fv[view / U] + m, u = fu[view % U] + n;
                const float along = v * fy[y] + u * fx[x];
                const float d = power > 0.0f ? clamp(along / power, -reach, reach) : 0.0f;
                const float away_v = v - d * fy[y], away_u = u - d * fx[x];
                nearest = min(nearest, away_v * away_v + away_u * away_u);
            }
        F[row + x] *= exp(-nearest * half_over_variance);
    }
}
