/* Projection of volumes to pictures of lenslets and back, a real matrix for each frequency.
 *
 *   forward    g[b, q, i] (+)= sum_j R[q, i, j] f[b, q, j]
 *   backward   f[b, q, j]    = sum_i R[q, i, j] g[b, q, i]
 *
 * R, f, g: packed by lattice_spectra.cl, f and g with four columns per row, in blocks of sixteen
 * frequencies; i < rows counts samples of a lenslet's picture, j < columns voxels of a lenslet.
 *
 * HEIGHT rows of the result and four columns of a frame stay in registers, summed over DEPTH terms.
 * HEIGHT x DEPTH numbers of R are read once and stay in the first-level cache for all frames b; DEPTH
 * rows of all frames and PANEL rows of the result stay in the second-level cache.
 *
 * -DLANES=1 | 16  frequencies of an item
 * -DHEIGHT=n      rows of the result in registers
 * -DDEPTH=n       terms of a sum before the next rows, with -DROWS
 * -DPANEL=n       rows of the result that are summed before the next rows, with -DROWS
 * -DADD           forward adds to g
 * -DROWS          see common.cl
 * Mapping: axis 0 = blocks of sixteen frequencies with -DROWS (an item takes all rows, CPUs); axis 0
 * = frequencies, axis 1 = HEIGHT rows of the result (GPUs).
 */
#include "common.cl"

#if LANES == 16
typedef float16 vec;
#else
typedef float vec;
#endif
#define STEP (16 / LANES) /* between successive rows of sixteen frequencies, in vectors */

/* A row of sixteen frequencies, from the frequency of the item on. */
inline __global const vec *row_of(__global const float *from, size_t row, int lane)
{
    return (__global const vec *)from + row * STEP + lane;
}

inline vec plus(const vec sum, const vec a, const vec b)
{
    return sum + a * b;
}

/* Add the sum over `terms` rows at `in` to `height` rows of the result of a frame, at `to`. In the
 * matrix, rows of the result are `apart` numbers apart, and terms `step` numbers. */
inline void sum_up(__global vec *to, __global const vec *in, __global const vec *matrix,
                   const int height, const int terms, const size_t apart, const size_t step,
                   const bool add)
{
    vec sum[HEIGHT][4];
    __global const vec *row[HEIGHT];
#pragma unroll
    for (int i = 0; i < HEIGHT; ++i) {
        const int own = min(i, height - 1);
        row[i] = matrix + own * apart;
#pragma unroll
        for (int k = 0; k < 4; ++k)
            sum[i][k] = add ? to[(4 * own + k) * STEP] : (vec)(0);
    }
    for (int j = 0; j < terms; ++j) {
        const vec a0 = in[(4 * j) * STEP], a1 = in[(4 * j + 1) * STEP];
        const vec a2 = in[(4 * j + 2) * STEP], a3 = in[(4 * j + 3) * STEP];
#pragma unroll
        for (int i = 0; i < HEIGHT; ++i) {
            const vec m = row[i][j * step];
            sum[i][0] = plus(sum[i][0], m, a0);
            sum[i][1] = plus(sum[i][1], m, a1);
            sum[i][2] = plus(sum[i][2], m, a2);
            sum[i][3] = plus(sum[i][3], m, a3);
        }
    }
#pragma unroll
    for (int i = 0; i < HEIGHT; ++i)
        if (i < height)
#pragma unroll
            for (int k = 0; k < 4; ++k)
                to[(4 * i + k) * STEP] = sum[i][k];
}

/* out[b, q, i] (+)= sum_j M[q, i, j] in[b, q, j], i < rows, j < terms; the strides of M are `apart`
 * for i and `step` for j. */
inline void multiply(__global float *out, __global const float *M, __global const float *in,
                     const int rows, const int terms, const size_t apart, const size_t step,
                     const int blocks, const int frames, const bool add)
{
    const int at = get_global_id(0) * LANES, block = at / 16, lane = at % 16 / LANES;
    if (block >= blocks)
        return;
    __global const vec *matrix = row_of(M, (size_t)block * rows * terms, lane);
#ifdef ROWS
    for (int panel = 0; panel < rows; panel += PANEL)
        for (int start = 0; start < terms; start += DEPTH) {
            const int depth = min(DEPTH, terms - start);
            for (int first = panel; first < min(rows, panel + PANEL); first += HEIGHT)
#else
    const int start = 0, depth = terms, first = get_global_id(1) * HEIGHT;
    {
        if (first < rows)
#endif
                for (int b = 0; b < frames; ++b) {
                    const size_t where = (size_t)b * blocks + block;
                    sum_up((__global vec *)row_of(out, (where * rows + first) * 4, lane),
                           row_of(in, (where * terms + start) * 4, lane),
                           matrix + (first * apart + start * step) * STEP,
                           min(HEIGHT, rows - first), depth, apart * STEP,
                           step * STEP, add || start > 0);
                }
        }
}

__kernel void forward(__global float *restrict g, __global const float *restrict R,
                      __global const float *restrict f, const int rows, const int columns,
                      const int blocks, const int frames)
{
#ifdef ADD
    const bool add = true;
#else
    const bool add = false;
#endif
    multiply(g, R, f, rows, columns, columns, 1, blocks, frames, add);
}

__kernel void backward(__global float *restrict f, __global const float *restrict R,
                       __global const float *restrict g, const int rows, const int columns,
                       const int blocks, const int frames)
{
    multiply(f, R, g, columns, rows, 1, columns, blocks, frames, false);
}
