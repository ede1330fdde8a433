/* All-in-focus picture from the planes of a focal stack.
 *
 *   between   out = (1 - t) R[p] + t R[p + 1],  p + t = place[y, x], a fractional plane index
 *   blend     out = sum_p m_p R[p] / sum_p m_p,  m_p = (E[p, y, x] / max_p E)^(2^doublings);
 *             equal weights where E is 0
 *
 * Mapping: FOR_X over (x, c); axis 1 = y. -DROWS: see common.cl.
 */
#include "common.cl"

__kernel void between(__global float *restrict out, __global const float *restrict R,
                      __global const float *restrict place, const int planes, const int ny,
                      const int nx, const int channels)
{
    const int y = get_global_id(1), n = nx * channels;
    FOR_X(s, n) {
        const float at = clamp(place[(size_t)y * nx + s / channels], 0.0f, (float)(planes - 1));
        const int p = min((int)at, max(planes - 2, 0));
        const float t = at - p;
        const float first = R[row_start(p, y, ny, n) + s];
        const float next = R[row_start(min(p + 1, planes - 1), y, ny, n) + s];
        out[row_start(0, y, ny, n) + s] = (1.0f - t) * first + t * next;
    }
}

__kernel void blend(__global float *restrict out, __global const float *restrict R,
                    __global const float *restrict E, const int doublings, const int planes,
                    const int ny, const int nx, const int channels)
{
    const int y = get_global_id(1), n = nx * channels;
    FOR_X(s, n) {
        __global const float *energy = E + (size_t)y * nx + s / channels;
        float highest = 0.0f, sum = 0.0f, used = 0.0f;
        for (int p = 0; p < planes; ++p)
            highest = max(highest, energy[row_start(p, 0, ny, nx)]);
        for (int p = 0; p < planes; ++p) {
            float m = highest > 0.0f ? energy[row_start(p, 0, ny, nx)] / highest : 1.0f;
            for (int i = 0; i < doublings; ++i)
                m *= m;
            sum += m * R[row_start(p, y, ny, n) + s];
            used += m;
        }
        out[row_start(0, y, ny, n) + s] = sum / used;
    }
}
