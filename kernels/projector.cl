/* Projection of volumes to pictures of lenslets and back, a real matrix for each frequency.
 *
 *   forward    g[b, q, i] (+)= sum_j R[q, i, j] f[b, q, j]
 *   backward   f[b, q, j]    = sum_i R[q, i, j] g[b, q, i]
 *
 * R, f, g: as lattice_spectra.cl packs them, f and g with four columns a row, sixteen frequencies
 * to a block; i < rows counts samples of a lenslet's picture, j < columns voxels of a lenslet.
 *
 * An item takes HEIGHT rows i (forward) or the STRETCH rows j of one plane (backward). With -DROWS
 * axis 0 = these, axis 1 = blocks of frequencies, sixteen frequencies a vector (CPUs); without it
 * axis 0 = frequencies (GPUs). Each number of R is read once for all frames b and four columns.
 *
 * R of point images that change their sign where y is mirrored (-DMIRRORED) or where all is turned by
 * 180 degrees (-DTURNED: it is that of i times the images) takes the columns at (-y, x) with the
 * opposite sign, and all columns times -i, backward times i.
 *
 * -DLANES=1 | 16  frequencies of an item
 * -DHEIGHT=n      rows of the picture in registers
 * -DADD           adds to what is there
 * -DROWS          see common.cl
 */
#include "common.cl"

#if LANES == 16
typedef float16 vec;
#else
typedef float vec;
#endif
#define STEP (16 / LANES) /* from one row of sixteen frequencies to the next, in vectors */

#ifdef TURNED
#define COLUMN(k) ((k) ^ 1)
#define TURN(k) ((k) & 1 ? -1 : 1)
#define BACK(k) ((k) & 1 ? 1 : -1)
#else
#define COLUMN(k) (k)
#define TURN(k) 1
#define BACK(k) 1
#endif
#ifdef MIRRORED
#define SIGN(k) ((k) < 2 ? 1 : -1)
#else
#define SIGN(k) 1
#endif

#ifdef ADD
#define ADDED 1
#else
#define ADDED 0
#endif

/* A row of sixteen frequencies, from the item's own on. */
inline __global const vec *row_of(__global const float *from, size_t row, int lane)
{
    return (__global const vec *)from + row * STEP + lane;
}

__kernel void forward(__global float *restrict g, __global const float *restrict R,
                      __global const float *restrict f, const int rows, const int columns,
                      const int blocks, const int frames)
{
#ifdef ROWS
    const int first = get_global_id(0) * HEIGHT, at = get_global_id(1) * LANES;
#else
    const int first = get_global_id(1) * HEIGHT, at = get_global_id(0) * LANES;
#endif
    const int block = at / 16, lane = at % 16 / LANES;
    if (block >= blocks || first >= rows)
        return;
    __global const vec *matrix[HEIGHT];
#pragma unroll
    for (int i = 0; i < HEIGHT; ++i)
        matrix[i] = row_of(R, ((size_t)block * rows + min(first + i, rows - 1)) * columns, lane);
    for (int b = 0; b < frames; ++b) {
        const size_t where = (size_t)b * blocks + block;
        __global const vec *in = row_of(f, where * columns * 4, lane);
        __global vec *out = (__global vec *)row_of(g, (where * rows + first) * 4, lane);
        vec sum[HEIGHT][4];
#pragma unroll
        for (int i = 0; i < HEIGHT; ++i)
#pragma unroll
            for (int k = 0; k < 4; ++k)
                sum[i][k] = (vec)(0);
        for (int j = 0; j < columns; ++j) {
            const vec a0 = in[(4 * j + COLUMN(0)) * STEP], a1 = in[(4 * j + COLUMN(1)) * STEP];
            const vec a2 = in[(4 * j + COLUMN(2)) * STEP], a3 = in[(4 * j + COLUMN(3)) * STEP];
#pragma unroll
            for (int i = 0; i < HEIGHT; ++i) {
                const vec m = matrix[i][j * STEP];
                sum[i][0] += m * (TURN(0) * SIGN(0) * a0);
                sum[i][1] += m * (TURN(1) * SIGN(1) * a1);
                sum[i][2] += m * (TURN(2) * SIGN(2) * a2);
                sum[i][3] += m * (TURN(3) * SIGN(3) * a3);
            }
        }
#pragma unroll
        for (int i = 0; i < HEIGHT; ++i)
            if (first + i < rows)
#pragma unroll
                for (int k = 0; k < 4; ++k)
#ifdef ADD
                    out[(4 * i + k) * STEP] += sum[i][k];
#else
                    out[(4 * i + k) * STEP] = sum[i][k];
#endif
    }
}

/* Adds what HEIGHT rows i give to the STRETCH rows of f, or sets them. */
__kernel void backward(__global float *restrict f, __global const float *restrict R,
                       __global const float *restrict g, const int rows, const int columns,
                       const int stretch, const int blocks, const int frames)
{
#ifdef ROWS
    const int start = get_global_id(0) * stretch, at = get_global_id(1) * LANES;
#else
    const int start = get_global_id(1) * stretch, at = get_global_id(0) * LANES;
#endif
    const int block = at / 16, lane = at % 16 / LANES;
    if (block >= blocks || start >= columns)
        return;
    const int stop = min(start + stretch, columns);
    for (int first = 0; first < rows; first += HEIGHT)
        for (int b = 0; b < frames; ++b) {
            const size_t where = (size_t)b * blocks + block;
            __global const vec *in = row_of(g, where * rows * 4, lane);
            __global vec *out = (__global vec *)row_of(f, where * columns * 4, lane);
            __global const vec *matrix[HEIGHT];
            vec part[HEIGHT][4];
#pragma unroll
            for (int i = 0; i < HEIGHT; ++i) {
                const int row = min(first + i, rows - 1);
                const float there = first + i < rows ? 1 : 0;
                matrix[i] = row_of(R, ((size_t)block * rows + row) * columns, lane);
#pragma unroll
                for (int k = 0; k < 4; ++k)
                    part[i][k] = in[(4 * row + COLUMN(k)) * STEP] * (there * BACK(k) * SIGN(k));
            }
            for (int j = start; j < stop; ++j) {
                vec sum[4];
#pragma unroll
                for (int k = 0; k < 4; ++k)
                    sum[k] = first || ADDED ? out[(4 * j + k) * STEP] : (vec)(0);
#pragma unroll
                for (int i = 0; i < HEIGHT; ++i) {
                    const vec m = matrix[i][j * STEP];
#pragma unroll
                    for (int k = 0; k < 4; ++k)
                        sum[k] += m * part[i][k];
                }
#pragma unroll
                for (int k = 0; k < 4; ++k)
                    out[(4 * j + k) * STEP] = sum[k];
            }
        }
}
