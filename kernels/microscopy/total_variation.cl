/* Prior for a small total variation, in a Richardson-Lucy step (Dey et al. 2006):
 *
 *   steepness   S = 1/sqrt(|g|^2 + e^2),  g = grad(V/t)
 *   restrain    B = B/(1 - a div(S g))
 *
 * g are differences to the next voxel along x, y and z (0 for the last voxel), div sums differences to
 * the previous voxel. Lengths are in sides of a voxel: t[z] is the thickness of a plane, gap[z] the
 * distance to the next plane above[z] of larger z; below[z] is the next plane of smaller z. Without
 * such a plane they are z itself. Planes are in any order. a, e: of the frame.
 * Mapping: FOR_X of common.cl over (frames planes, ny, nx). -DROWS: see common.cl.
 */
#include "common.cl"

__kernel void steepness(__global float *restrict S, __global const float *restrict V,
                        __global const float *restrict e, __global const float *restrict t,
                        __global const float *restrict gap, __global const int *restrict above,
                        const int planes, const int ny, const int nx)
{
    const int y = get_global_id(1), frame = get_global_id(2) / planes, first = frame * planes;
    const int z = get_global_id(2) - first, up = above[z];
    const float thin = 1 / t[z], upper = 1 / (t[up] * gap[z]), lower = 1 / (t[z] * gap[z]);
    const float e2 = e[frame] * e[frame];
    const size_t row = row_start(first + z, y, ny, nx);
    const size_t high = row_start(first + up, y, ny, nx), far = y + 1 < ny ? row + nx : row;
    FOR_X(x, nx) {
        const float here = V[row + x];
        const float gx = ((x + 1 < nx ? V[row + x + 1] : here) - here) * thin;
        const float gy = (V[far + x] - here) * thin;
        const float gz = upper * V[high + x] - lower * here;
        S[row + x] = 1 / sqrt(gx * gx + gy * gy + gz * gz + e2);
    }
}

__kernel void restrain(__global float *restrict B, __global const float *restrict V,
                       __global const float *restrict S, __global const float *restrict a,
                       __global const float *restrict t, __global const float *restrict gap,
                       __global const int *restrict above, __global const int *restrict below,
                       const int planes, const int ny, const int nx)
{
    const int y = get_global_id(1), frame = get_global_id(2) / planes, first = frame * planes;
    const int z = get_global_id(2) - first, up = above[z], down = below[z];
    const float weight = a[frame] / t[z];
    /* z component of g over t, from the densities of the plane and its neighbours */
    const float upper = 1 / (t[up] * gap[z]), lower = 1 / (t[z] * gap[z]);
    const float before = 1 / (t[z] * gap[down]), last = 1 / (t[down] * gap[down]);
    const size_t row = row_start(first + z, y, ny, nx);
    const size_t high = row_start(first + up, y, ny, nx), low = row_start(first + down, y, ny, nx);
    const size_t far = y + 1 < ny ? row + nx : row, near = y > 0 ? row - nx : row;
    FOR_X(x, nx) {
        const float here = V[row + x], left = x > 0 ? V[row + x - 1] : here;
        const float right = x + 1 < nx ? V[row + x + 1] : here;
        const float own = right + V[far + x] - 2 * here + upper * V[high + x] - lower * here;
        const float other = (x > 0 ? S[row + x - 1] : 0) * (here - left)
            + S[near + x] * (here - V[near + x]) + S[low + x] * (before * here - last * V[low + x]);
        B[row + x] /= 1 - weight * (S[row + x] * own - other);
    }
}
