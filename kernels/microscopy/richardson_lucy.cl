/* Steps of the Richardson-Lucy iteration V <- V H'(w I/(w H V + b)) / H'w.
 *
 *   expected   E = w E + b
 *   ratio      out = w I/E, 0 where E or w is 0
 *   update     V = V B/N, 0 where N <= least
 *   moved      G = X - Y
 *   ahead      X = Y = max(x + a (x - P), 0), P = x, with the previous X as x, a of the frame
 *
 * for arrays of (frames, size), b included; w, N: (size), common to all frames.
 * Mapping: FOR_X of common.cl over (frames, ny, nx) with ny nx = size. -DROWS: see common.cl.
 */
#include "common.cl"

__kernel void expected(__global float *restrict E, __global const float *restrict w,
                       __global const float *restrict b, const int ny, const int nx)
{
    const int y = get_global_id(1);
    const size_t row = row_start(get_global_id(2), y, ny, nx), same = row_start(0, y, ny, nx);
    FOR_X(x, nx)
        E[row + x] = w[same + x] * E[row + x] + b[row + x];
}

__kernel void ratio(__global float *restrict out, __global const float *restrict I,
                    __global const float *restrict E, __global const float *restrict w,
                    const int ny, const int nx)
{
    const int y = get_global_id(1);
    const size_t row = row_start(get_global_id(2), y, ny, nx), same = row_start(0, y, ny, nx);
    FOR_X(x, nx) {
        const float e = E[row + x];
        out[row + x] = e > 0 && w[same + x] > 0 ? w[same + x] * (I[row + x] / e) : 0;
    }
}

__kernel void update(__global float *restrict V, __global const float *restrict B,
                     __global const float *restrict N, const float least, const int ny,
                     const int nx)
{
    const int y = get_global_id(1);
    const size_t row = row_start(get_global_id(2), y, ny, nx), same = row_start(0, y, ny, nx);
    FOR_X(x, nx) {
        const float n = N[same + x], b = B[row + x];
        V[row + x] = n > least ? V[row + x] * (b > 0 ? b : 0) / n : 0;
    }
}

__kernel void moved(__global float *restrict G, __global const float *restrict X,
                    __global const float *restrict Y, const int ny, const int nx)
{
    const size_t row = row_start(get_global_id(2), get_global_id(1), ny, nx);
    FOR_X(x, nx)
        G[row + x] = X[row + x] - Y[row + x];
}

__kernel void ahead(__global float *restrict X, __global float *restrict Y,
                    __global float *restrict P, __global const float *restrict a, const int ny,
                    const int nx)
{
    const float step = a[get_global_id(2)];
    const size_t row = row_start(get_global_id(2), get_global_id(1), ny, nx);
    FOR_X(x, nx) {
        const float here = X[row + x];
        X[row + x] = Y[row + x] = fmax(here + step * (here - P[row + x]), 0);
        P[row + x] = here;
    }
}
