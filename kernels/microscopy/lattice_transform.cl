/* Pictures of lenslets to packed spectra and back in a single step: lattice.cl, the Fourier transforms
 * and lattice_spectra.cl, which define C and D, with C in the cache only.
 *
 *   spectra    D = pack of the transforms over y and x of C = decimate of a
 *   pictures   a = interleave of the inverse transforms of C = unpack of D, the transpose of spectra
 *              times its part of 1/(ny nx); no sample is below `least`
 *
 * Sixteen fields C are transformed together, a field per lane. Along y only the columns with lenslets
 * are transformed, along x only the rows from which lenslets result. A transform over n = p q r ... is
 * Stockham's self-sorting transform (Cochran et al. 1967), in radices of 2, 3, 4, 5 and 7:
 *
 *   X'[i + m (k + l j)] = w_n^(l i j) sum_s w_p^(j s) X[i + m (s + p k)],   n = l p m,  w_n = exp(-2 pi i/n)
 *
 * for k < l, i < m, j < p, where l is the product of the previous radices. The inverse transforms
 * fields with exchanged real and imaginary parts.
 *
 * turns_y, turns_x: w_n^t, t < n; radices_y, radices_x: the radices, terminated by 0. scratch:
 * 2 ny nx + 10 max(ny, nx) vectors per item. batch: number of fields; other arguments as in
 * lattice.cl and lattice_spectra.cl.
 *
 * For CPUs. Mapping: axis 0 = items, which share the groups of sixteen fields in turn.
 */
#include "common.cl"

#define WIDTH 16
#define HALF_ROOT 0.70710678f
typedef float16 vec;

/* sum + a b, as a function of vectors: clang splits the inlined expression into two halves. */
inline vec plus(const vec sum, const vec a, const vec b)
{
    return sum + a * b;
}

/* fmax is a call for each lane with some compilers. */
inline vec at_least(const vec value, const vec least)
{
    return value > least ? value : least;
}

#define EACH _Pragma("unroll") for

#define BUTTERFLY_1
#define BUTTERFLY_2                                                                                 \
    const vec r = re[1], i = im[1];                                                                 \
    re[1] = re[0] - r, im[1] = im[0] - i;                                                           \
    re[0] += r, im[0] += i;

#define BUTTERFLY_4                                                                                 \
    const vec ar = re[0] + re[2], ai = im[0] + im[2], br = re[0] - re[2], bi = im[0] - im[2];       \
    const vec cr = re[1] + re[3], ci = im[1] + im[3], dr = re[1] - re[3], di = im[1] - im[3];       \
    re[0] = ar + cr, im[0] = ai + ci, re[2] = ar - cr, im[2] = ai - ci;                             \
    re[1] = br + di, im[1] = bi - dr, re[3] = br - di, im[3] = bi + dr;

/* cos and sin of 2 pi t/p */
__constant float COS_3[3] = {1, -0.5f, -0.5f};
__constant float SIN_3[3] = {0, 0.866025404f, -0.866025404f};
__constant float COS_5[5] = {1, 0.309016994f, -0.809016994f, -0.809016994f, 0.309016994f};
__constant float SIN_5[5] = {0, 0.951056516f, 0.587785252f, -0.587785252f, -0.951056516f};
__constant float COS_7[7] = {1, 0.623489802f, -0.222520934f, -0.900968868f, -0.900968868f,
                             -0.222520934f, 0.623489802f};
__constant float SIN_7[7] = {0, 0.781831482f, 0.974927912f, 0.433883739f, -0.433883739f,
                             -0.974927912f, -0.781831482f};

/* An odd radix, by the sums and differences of its pairs j and p - j. */
#define ODD(P)                                                                                      \
    vec sr[P / 2], si[P / 2], dr[P / 2], di[P / 2];                                                 \
    const vec r = re[0], i = im[0];                                                                 \
    EACH (int j = 0; j < P / 2; ++j) {                                                              \
        sr[j] = re[j + 1] + re[P - 1 - j], si[j] = im[j + 1] + im[P - 1 - j];                       \
        dr[j] = re[j + 1] - re[P - 1 - j], di[j] = im[j + 1] - im[P - 1 - j];                       \
        re[0] += sr[j], im[0] += si[j];                                                             \
    }                                                                                               \
    EACH (int k = 1; k <= P / 2; ++k) {                                                             \
        vec cr = r, ci = i, er = (vec)(0), ei = (vec)(0);                                           \
        EACH (int j = 0; j < P / 2; ++j) {                                                          \
            const vec c = COS_##P[(j + 1) * k % P], s = SIN_##P[(j + 1) * k % P];                   \
            cr = plus(cr, c, sr[j]), ci = plus(ci, c, si[j]);                                       \
            er = plus(er, s, dr[j]), ei = plus(ei, s, di[j]);                                       \
        }                                                                                           \
        re[k] = cr + ei, im[k] = ci - er, re[P - k] = cr - ei, im[P - k] = ci + er;                 \
    }
#define BUTTERFLY_3 ODD(3)
#define BUTTERFLY_5 ODD(5)
#define BUTTERFLY_7 ODD(7)

/* A pass of a transform from X to X', whose samples are `step` pairs of vectors apart. */
#define PASS(P)                                                                                     \
    inline void pass_##P(__global vec *to, const int to_step, __global const vec *from,             \
                         const int from_step, __global const float2 *turns, const int before,       \
                         const int after)                                                           \
    {                                                                                               \
        for (int k = 0; k < before; ++k)                                                            \
            for (int m = 0; m < after; ++m) {                                                       \
                vec re[P], im[P];                                                                   \
                EACH (int j = 0; j < P; ++j) {                                                      \
                    __global const vec *at = from + 2 * from_step * (m + after * (j + P * k));      \
                    re[j] = at[0], im[j] = at[1];                                                   \
                }                                                                                   \
                {                                                                                   \
                    BUTTERFLY_##P                                                                   \
                }                                                                                   \
                EACH (int j = 0; j < P; ++j) {                                                      \
                    __global vec *at = to + 2 * to_step * (m + after * (k + before * j));           \
                    if (j && m) {                                                                   \
                        const float2 w = turns[before * m * j];                                     \
                        at[0] = plus(re[j] * w.x, im[j], (vec)(-w.y));                              \
                        at[1] = plus(im[j] * w.x, re[j], (vec)(w.y));                               \
                    } else {                                                                        \
                        at[0] = re[j], at[1] = im[j];                                               \
                    }                                                                               \
                }                                                                                   \
            }                                                                                       \
    }
PASS(1)
PASS(2)
PASS(3)
PASS(4)
PASS(5)
PASS(7)

/* The transform of n samples; temp has 4 n vectors. */
inline void transform(__global vec *to, const int to_step, __global const vec *from, int from_step,
                      __global vec *temp, __global const float2 *turns,
                      __global const int *radices, const int n)
{
    int before = 1;
    for (int number = 0; radices[number]; ++number) {
        const int p = radices[number], after = n / (before * p), last = !radices[number + 1];
        __global vec *target = last ? to : temp + (number & 1) * 2 * n;
        const int step = last ? to_step : 1;
        switch (p) {
        case 1: pass_1(target, step, from, from_step, turns, before, after); break;
        case 2: pass_2(target, step, from, from_step, turns, before, after); break;
        case 3: pass_3(target, step, from, from_step, turns, before, after); break;
        case 4: pass_4(target, step, from, from_step, turns, before, after); break;
        case 5: pass_5(target, step, from, from_step, turns, before, after); break;
        case 7: pass_7(target, step, from, from_step, turns, before, after); break;
        }
        from = target;
        from_step = 1;
        before *= p;
    }
}

/* Interleave the lanes of two vectors. */
inline vec shuffled(const float8 even, const float8 odd)
{
    vec both;
    both.even = even;
    both.odd = odd;
    return both;
}

/* Rows become lanes: four perfect shuffles. */
inline void transpose(vec *rows)
{
    vec other[16];
    EACH (int time = 0; time < 2; ++time) {
        EACH (int i = 0; i < 8; ++i) {
            other[2 * i] = shuffled(rows[i].lo, rows[i + 8].lo);
            other[2 * i + 1] = shuffled(rows[i].hi, rows[i + 8].hi);
        }
        EACH (int i = 0; i < 8; ++i) {
            rows[2 * i] = shuffled(other[i].lo, other[i + 8].lo);
            rows[2 * i + 1] = shuffled(other[i].hi, other[i + 8].hi);
        }
    }
}

/* Sixteen fields: offsets of their samples in the pictures and of their rows in the spectra. */
typedef struct {
    size_t one[WIDTH], other[WIDTH]; /* of the samples m and m' of the first lenslet */
    size_t row[WIDTH], mirror[WIDTH]; /* of the rows of the pair and of its mirror image */
    float scale[WIDTH], sign[WIDTH]; /* of alpha; of beta in the mirror, 0 for a middle sample */
    int count;
} Fields;

inline void describe(Fields *fields, const int first, const int batch, const int wy, const int wx,
                     const int planes, const int start, const int all, const int rows,
                     const int columns, const int parts, const int blocks)
{
    const int V = wy * wx, pairs = (V + 1) / 2;
    const size_t width = (size_t)columns * wx;
    fields->count = min(WIDTH, batch - first);
    for (int l = 0; l < WIDTH; ++l) {
        const int field = min(first + l, batch - 1), r = field % pairs, stack = field / pairs;
        const int b = stack / planes, plane = stack % planes, my = r / wx, mx = r % wx;
        const int turned = (wy - 1 - my) * wx + mx, s = min(turned, V - 1 - turned);
        const size_t picture = ((size_t)b * all + start + plane) * rows * wy * width;
        fields->one[l] = picture + my * width + mx;
        fields->other[l] = picture + (wy - 1 - my) * width + wx - 1 - mx;
        const size_t row = ((size_t)b * blocks * planes + plane) * parts * V;
        fields->row[l] = (row + 2 * r) * 4 * WIDTH;
        fields->mirror[l] = (row + 2 * s) * 4 * WIDTH;
        fields->scale[l] = 2 * r == V - 1 ? HALF_ROOT : 1;
        fields->sign[l] = 2 * r == V - 1 ? 0 : turned == s ? 1 : -1;
    }
}

/* Offset of a vector of alpha (0, 1) or beta (2, 3) of a frequency, or of its mirror image (4 to 7), in
 * a row of four columns. */
inline size_t place(const Fields *fields, const int l, const int k)
{
    const size_t row = k < 4 ? fields->row[l] : fields->mirror[l];
    return row + (k & 2 ? 4 * WIDTH : 0) + ((k & 1) + (k < 4 ? 0 : 2)) * WIDTH;
}

/* Index of a vector in a part: odd parts (bit 0) are multiplied by i. */
inline int source(const int k, const int part)
{
    return part & 1 ? k ^ 1 : k;
}

inline float factor(const int k, const int part)
{
    return (part & 1 && !(k & 1) ? -1 : 1) * (part & 2 && k > 3 ? -1 : 1);
}

/* Write a block of sixteen frequencies, whose lanes become rows, at rising addresses. */
inline void write_block(__global float *D, const Fields *fields, vec held[8][WIDTH],
                        const size_t block, const int planes, const int parts, const int bits,
                        const int V)
{
    for (int k = 0; k < 8; ++k)
        transpose(held[k]);
    for (int p = 0; p < parts; ++p) {
        const int part = bits >> 2 * p & 3;
        __global float *to = D + (block * planes * parts + p) * V * 4 * WIDTH;
        for (int l = 0; l < fields->count; ++l)
            for (int k = 0; k < 8; ++k)
                if (!(k & 2) || fields->sign[l] != 0)
                    *(__global vec *)(to + place(fields, l, k)) =
                        held[source(k, part)][l] * factor(k, part);
    }
}

/* Read a block of sixteen frequencies, summed over its parts. */
inline void read_block(vec held[8][WIDTH], __global const float *D, const Fields *fields,
                       const size_t block, const int planes, const int parts, const int bits,
                       const int V)
{
    for (int p = 0; p < parts; ++p) {
        const int part = bits >> 2 * p & 3;
        __global const float *from = D + (block * planes * parts + p) * V * 4 * WIDTH;
        for (int l = 0; l < WIDTH; ++l)
            for (int k = 0; k < 8; ++k) {
                const int own = source(k, part);
                vec value = p ? held[k][l] : (vec)(0);
                if (!(k & 2) || fields->sign[l] != 0) /* a middle sample has no second row */
                    value = plus(value, *(__global const vec *)(from + place(fields, l, own)),
                                 (vec)(factor(own, part)));
                held[k][l] = value;
            }
    }
    for (int k = 0; k < 8; ++k)
        transpose(held[k]);
}

__kernel void spectra(__global float *restrict D, __global const float *restrict a,
                      __global float *restrict scratch, __global const float2 *restrict turns_y,
                      __global const int *restrict radices_y,
                      __global const float2 *restrict turns_x,
                      __global const int *restrict radices_x, const int batch, const int wy,
                      const int wx, const int planes, const int start, const int all,
                      const int rows, const int columns, const int parts, const int bits,
                      const int ny, const int nx)
{
    const int longest = max(ny, nx), hx = nx / 2 + 1, count = (ny / 2 + 1) * hx;
    const int blocks = (count + WIDTH - 1) / WIDTH, V = wy * wx;
    __global vec *plane = (__global vec *)scratch +
                          get_global_id(0) * (2 * (size_t)ny * nx + 10 * longest);
    __global vec *temp = plane + 2 * (size_t)ny * nx, *line = temp + 4 * longest;
    __global vec *upper = line + 2 * longest, *lower = upper + 2 * longest;
    const size_t down = (size_t)columns * wx * wy; /* from lenslet to lenslet */
    Fields fields;
    vec held[8][WIDTH];
    for (int y = 0; y < ny; ++y)
        for (int x = 2 * columns; x < 2 * nx; ++x)
            plane[2 * y * nx + x] = (vec)(0);
    for (int first = get_global_id(0) * WIDTH; first < batch; first += get_global_size(0) * WIDTH) {
        describe(&fields, first, batch, wy, wx, planes, start, all, rows, columns, parts, blocks);
        for (int y = 0; y < ny; ++y)
            for (int x = 0; x < columns; ++x) {
                __global float *to = (__global float *)(plane + 2 * (y * nx + x));
                if (y < rows) {
                    __global const float *from = a + y * down + x * wx;
                    for (int l = 0; l < WIDTH; ++l)
                        to[l] = from[fields.one[l]], to[l + WIDTH] = from[fields.other[l]];
                } else {
                    ((__global vec *)to)[0] = ((__global vec *)to)[1] = (vec)(0);
                }
            }
        for (int x = 0; x < columns; ++x)
            transform(plane + 2 * x, nx, plane + 2 * x, nx, temp, turns_y, radices_y, ny);
        vec scale, sign;
        for (int l = 0; l < WIDTH; ++l)
            ((float *)&scale)[l] = fields.scale[l], ((float *)&sign)[l] = fields.sign[l];
        int q = 0;
        for (int y = 0; y <= ny / 2; ++y) {
            const int oy = (ny - y) % ny;
            transform(upper, 1, plane + 2 * y * nx, 1, temp, turns_x, radices_x, nx);
            __global const vec *mirror = oy == y ? upper : lower;
            if (oy != y)
                transform(lower, 1, plane + 2 * oy * nx, 1, temp, turns_x, radices_x, nx);
            for (int x = 0; x < hx; ++x, ++q) {
                const int ox = (nx - x) % nx, at = q % WIDTH;
                EACH (int side = 0; side < 2; ++side) {
                    __global const vec *c = (side ? mirror : upper) + 2 * x;
                    __global const vec *o = (side ? upper : mirror) + 2 * ox;
                    const vec share = scale * (HALF_ROOT / 2);
                    const vec Ar = c[0] + o[0], Ai = c[1] - o[1];
                    const vec Br = c[1] + o[1], Bi = o[0] - c[0];
                    held[4 * side][at] = share * (Ar + Br);
                    held[4 * side + 1][at] = share * (Ai + Bi);
                    const vec turned = side ? share * sign : share;
                    held[4 * side + 2][at] = turned * (Ai - Bi);
                    held[4 * side + 3][at] = turned * (Br - Ar);
                }
                if (at == WIDTH - 1)
                    write_block(D, &fields, held, q / WIDTH, planes, parts, bits, V);
            }
        }
        if (q % WIDTH) {
            for (int k = 0; k < 8; ++k)
                for (int at = q % WIDTH; at < WIDTH; ++at)
                    held[k][at] = (vec)(0);
            write_block(D, &fields, held, q / WIDTH, planes, parts, bits, V);
        }
    }
}

/* C from alpha and beta at one frequency and at the opposite one, with real and imaginary part in each
 * other's place. */
inline void unpack_swapped(__global vec *near, __global vec *far, const vec alpha_re,
                           const vec alpha_im, const vec beta_re, const vec beta_im)
{
    const vec Ar = alpha_re - beta_im, Ai = alpha_im + beta_re;
    const vec Br = alpha_re + beta_im, Bi = alpha_im - beta_re;
    near[1] = Ar - Bi, near[0] = Ai + Br;
    if (far)
        far[1] = Ar + Bi, far[0] = Br - Ai;
}

__kernel void pictures(__global float *restrict a, __global const float *restrict D,
                       __global float *restrict scratch, __global const float2 *restrict turns_y,
                       __global const int *restrict radices_y,
                       __global const float2 *restrict turns_x,
                       __global const int *restrict radices_x, const float least, const int batch,
                       const int wy, const int wx, const int planes, const int start,
                       const int all, const int rows, const int columns, const int parts,
                       const int bits, const int ny, const int nx)
{
    const int longest = max(ny, nx), hx = nx / 2 + 1, count = (ny / 2 + 1) * hx;
    const int blocks = (count + WIDTH - 1) / WIDTH, V = wy * wx;
    __global vec *plane = (__global vec *)scratch +
                          get_global_id(0) * (2 * (size_t)ny * nx + 10 * longest);
    __global vec *temp = plane + 2 * (size_t)ny * nx, *line = temp + 4 * longest;
    __global vec *upper = line + 2 * longest, *lower = upper + 2 * longest;
    const size_t down = (size_t)columns * wx * wy;
    const float part = 1.0f / ((float)ny * nx);
    Fields fields;
    vec held[8][WIDTH];
    for (int first = get_global_id(0) * WIDTH; first < batch; first += get_global_size(0) * WIDTH) {
        describe(&fields, first, batch, wy, wx, planes, start, all, rows, columns, parts, blocks);
        vec scale, sign;
        for (int l = 0; l < WIDTH; ++l) {
            ((float *)&scale)[l] = part * (fields.scale[l] < 1 ? 1 : HALF_ROOT);
            ((float *)&sign)[l] = fields.sign[l];
        }
        int q = 0;
        for (int y = 0; y <= ny / 2; ++y) {
            const int oy = (ny - y) % ny;
            for (int x = 0; x < hx; ++x, ++q) {
                const int at = q % WIDTH, ox = (nx - x) % nx;
                if (at == 0)
                    read_block(held, D, &fields, q / WIDTH, planes, parts, bits, V);
                const bool twice = ox >= hx;
                __global vec *opposite = (oy == y ? upper : lower) + 2 * ox;
                unpack_swapped(upper + 2 * x, twice ? opposite : 0, scale * held[0][at],
                               scale * held[1][at], scale * held[2][at], scale * held[3][at]);
                const vec turned = scale * sign;
                if (oy != y)
                    unpack_swapped(lower + 2 * x, twice ? upper + 2 * ox : 0, scale * held[4][at],
                                   scale * held[5][at], turned * held[6][at],
                                   turned * held[7][at]);
            }
            transform(line, 1, upper, 1, temp, turns_x, radices_x, nx);
            for (int x = 0; x < 2 * columns; ++x)
                plane[2 * y * nx + x] = line[x];
            if (oy != y) {
                transform(line, 1, lower, 1, temp, turns_x, radices_x, nx);
                for (int x = 0; x < 2 * columns; ++x)
                    plane[2 * oy * nx + x] = line[x];
            }
        }
        for (int x = 0; x < columns; ++x)
            transform(plane + 2 * x, nx, plane + 2 * x, nx, temp, turns_y, radices_y, ny);
        for (int y = 0; y < rows; ++y)
            for (int x = 0; x < columns; ++x) {
                __global vec *at = plane + 2 * (y * nx + x);
                at[0] = at_least(at[0], (vec)(least));
                at[1] = at_least(at[1], (vec)(least));
                __global const float *from = (__global const float *)at;
                __global float *to = a + y * down + x * wx;
                for (int l = 0; l < fields.count; ++l) { /* a middle sample is the real part */
                    to[fields.other[l]] = from[l];
                    to[fields.one[l]] = from[l + WIDTH];
                }
            }
    }
}
