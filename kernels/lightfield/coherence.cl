/* Most coherent orientation over the structure tensors of successive shears d0.
 *
 * H and V are smoothed sums (Lx Lx, Lx Lu, Lu Lu) along rows and along columns of views (tensor.cl).
 *
 *   c(J) = ((Jxx - Juu)^2 + 4 Jxu^2)/(Jxx + Juu)^2, 0 where Jxx <= Juu     coherence
 *   J = c(H) H + c(V) V,   d = d0 + Jxu/Jxx                               least squares
 *   best     c(J) of the most coherent shear with abs(d - d0) <= reach;  place = its d
 *   second   the highest c(J) with d more than `reach` away from `place`
 *
 * Mapping: FOR_X of common.cl. -DROWS.
 */
#include "common.cl"

inline float coherence(const float xx, const float xu, const float uu)
{
    const float sum = xx + uu, difference = xx - uu;
    return xx > uu ? (difference * difference + 4 * xu * xu) / (sum * sum) : 0.0f;
}

__kernel void most_coherent(__global float *restrict best, __global float *restrict second,
                            __global float *restrict place, __global const float *restrict J,
                            const float d0, const float reach, const int ny, const int nx)
{
    const size_t row = row_start(0, get_global_id(1), ny, nx);
    const size_t size = (size_t)ny * nx;
    FOR_X(x, nx) {
        const size_t i = row + x;
        __global const float *H = J + i, *V = H + 3 * size;
        const float h = coherence(H[0], H[size], H[2 * size]);
        const float v = coherence(V[0], V[size], V[2 * size]);
        const float xx = h * H[0] + v * V[0];
        const float xu = h * H[size] + v * V[size];
        const float uu = h * H[2 * size] + v * V[2 * size];
        const float off = xx > 0.0f ? xu / xx : 0.0f;
        const float c = fabs(off) <= reach ? coherence(xx, xu, uu) : 0.0f;
        const float d = d0 + off;
        const float other = fabs(d - place[i]) > reach ? fmin(best[i], c) : 0.0f;
        second[i] = fmax(second[i], other);
        place[i] = c > best[i] ? d : place[i];
        best[i] = fmax(best[i], c);
    }
}
