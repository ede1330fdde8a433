/* Transmission of a microlens array in closed form at real coordinates.
 *
 *   t(y, x) = A(y, x) exp(-i pi r^2/(lam f)),  r = distance to the nearest lenslet's centre,
 *   f = that of the lenslet's kind, turns[kind] = pitch^2/(2 lam f)
 *   A = fraction of the sample's cell that the lenslets' apertures cover
 *
 * Coordinates are in pitches along the array's columns (a) and rows (b). The contributions of x and y
 * to each are 1-D tables of (integer, fraction), in double precision on the host, so that float32 is
 * sufficient for the phase at sub-pixel pitches and far corners.
 *
 * -DHEXAGONAL       rows sqrt(3)/2 pitch apart, odd rows shifted by +1/2; square lattice otherwise
 * -DFULL            the aperture is the lattice cell (square or hexagon); a disc otherwise
 * -DTYPES=n         number of kinds of lenslets; for their order on the lattice see lens_types.cl
 * -DTYPE_STEP=s     see lens_types.cl
 * -DFILTERED        A is a step across the rim without frequencies beyond the samples' band
 *                   (rim_weights.cl); neighbours overlap at the rim, each with its phase
 * -DLANES           sixteen samples at a time (with -DROWS, -DFILTERED, in float32, one kind)
 * -DROWS, -DDOUBLE  see common.cl
 *
 * Mapping: FOR_X of common.cl.
 */
#include "lens_types.cl"
#ifdef LANES
#include "lanes.cl"
#endif
#include "lenslet_coverage.cl"
#include "rim_weights.cl"

#ifdef FULL
#define IS_FULL true
#else
#define IS_FULL false
#endif

#ifdef FILTERED
/* Weight at offset (a, b) from a lenslet's centre, in pitches; `per_sample` samples a pitch. */
inline real filtered_rim(real a, real b, real radius, real per_sample,
                         __global const real *restrict rim, int rim_size)
{
#ifdef FULL
    const real x = fabs(a), y = fabs(b);
#ifdef HEXAGONAL
    const real across = fmax(x, x / 2 + y * ROW_HEIGHT);
    return rim_weight((radius - across) * per_sample, rim, rim_size);
#else
    return rim_weight((radius - x) * per_sample, rim, rim_size)
        * rim_weight((radius - y) * per_sample, rim, rim_size);
#endif
#else
    return rim_weight((radius - sqrt(a * a + b * b)) * per_sample, rim, rim_size);
#endif
}

/* Sum over the nearest lenslet and its neighbours of their weights times their phases. */
inline cplx filtered(Lenslet l, real radius, real per_sample, int rows, int columns,
                     __global const real *restrict turns, __global const real *restrict rim,
                     int rim_size)
{
#ifdef FULL
    const real beyond = radius * (real)1.4143f + 2 * RIM / per_sample; /* the corners of a cell */
#else
    const real beyond = radius + RIM / per_sample;
#endif
    cplx sum = (cplx)(0);
    for (int i = -1; i <= 1; ++i) {
        const int row = l.row + i;
        if (row < 0 || row >= rows)
            continue;
#ifdef HEXAGONAL
        const real shift = ((row & 1) - (l.row & 1)) * (real)0.5f;
#else
        const real shift = 0;
#endif
        for (int k = -1; k <= 1; ++k) {
            const int column = l.column + k;
            if (column < 0 || column >= columns)
                continue;
            const real a = l.a - k - shift, b = l.b - i * ROW_HEIGHT;
            if (a * a + b * b > beyond * beyond)
                continue;
            const real weight = filtered_rim(a, b, radius, per_sample, rim, rim_size);
            if (weight != 0)
                sum += weight * cis_turns(-turns[lens_type(row, column)] * (a * a + b * b));
        }
    }
    return sum;
}
#endif

#if defined(LANES) && defined(FILTERED)
/* Offsets (a, b) of sixteen samples from the nearest lenslet of a row, with its column. */
inline void in_row16(const float16 row, const float16 a_whole, const float16 a_part,
                     const float16 b_whole, const float16 b_part, const int columns, float16 *a,
                     float16 *b, float16 *column, float16 *shift)
{
    *b = ((b_whole - row) + b_part) * ROW_HEIGHT;
#ifdef HEXAGONAL
    *shift = row * 0.5f - floor(row * 0.5f);
#else
    *shift = 0;
#endif
    const float16 near = a_whole + rint(a_part - *shift);
    *column = fmin(fmax(near, (float16)0), (float16)(columns - 1));
    *a = ((a_whole - *column) + a_part) - *shift;
}

/* `filtered_rim` of sixteen samples, 0 where `out`; return true if a sample is lit. */
inline bool filtered_rims(const float16 a, const float16 b, const int16 out, const float radius,
                          const float per_sample, __global const float *rim, const int rim_size,
                          float16 *weight)
{
    union { float16 v; float one[16]; } first;
    const float outside = -2.0f * RIM;
#ifdef FULL
    const float16 x = fabs(a), y = fabs(b);
#ifdef HEXAGONAL
    first.v = (radius - fmax(x, x / 2 + y * ROW_HEIGHT)) * per_sample;
#else
    union { float16 v; float one[16]; } second;
    first.v = (radius - x) * per_sample;
    second.v = (radius - y) * per_sample;
#endif
#else
    first.v = (radius - sqrt(a * a + b * b)) * per_sample;
#endif
    first.v = out ? (float16)(outside) : first.v;
    bool lit = false;
    for (int i = 0; i < 16; ++i)
        lit |= first.one[i] > -RIM;
    if (!lit)
        return false;
    for (int i = 0; i < 16; ++i) {
        first.one[i] = rim_weight(first.one[i], rim, rim_size);
#if defined(FULL) && !defined(HEXAGONAL)
        first.one[i] *= rim_weight(second.one[i], rim, rim_size);
#endif
    }
    *weight = out ? (float16)(0) : first.v;
    return true;
}

/* Sixteen samples of an array of one kind of lenslets. */
inline void lenslets16(__global float *to, __global const float *a_of_x, __global const float *b_of_x,
                       const float2 a_row, const float2 b_row, const float turns,
                       const float radius, const float per_sample, __global const float *rim,
                       const int rim_size, const int rows, const int columns)
{
    float16 a_whole, a_part, b_whole, b_part, a, b, column, shift;
    deal(a_of_x, &a_whole, &a_part);
    deal(b_of_x, &b_whole, &b_part);
    a_whole += a_row.x;
    a_part += a_row.y;
    b_whole += b_row.x;
    b_part += b_row.y;
    const float16 last = rows - 1;
    const float16 middle = fmin(fmax(b_whole + rint(b_part), (float16)0), last);
    float16 row = middle;
    in_row16(row, a_whole, a_part, b_whole, b_part, columns, &a, &b, &column, &shift);
#ifdef HEXAGONAL
    for (int step = -1; step <= 1; step += 2) {
        const float16 next = fmin(fmax(middle + step, (float16)0), last);
        float16 na, nb, other, nshift;
        in_row16(next, a_whole, a_part, b_whole, b_part, columns, &na, &nb, &other, &nshift);
        const int16 nearer = na * na + nb * nb < a * a + b * b;
        row = nearer ? next : row;
        a = nearer ? na : a;
        b = nearer ? nb : b;
        column = nearer ? other : column;
        shift = nearer ? nshift : shift;
    }
#endif
    const float deep = radius - RIM / per_sample;
    union { float16 v; float one[16]; } r2;
    r2.v = a * a + b * b;
    bool inner = deep > 0;
    for (int i = 0; i < 16; ++i)
        inner &= r2.one[i] < deep * deep;
    float16 re, im, sum_re = 0, sum_im = 0;
    if (inner) {
        cis16(-turns * r2.v, &re, &im);
        merge(to, re, im);
        return;
    }
    for (int i = -1; i <= 1; ++i) {
        const float16 other = row + i;
#ifdef HEXAGONAL
        const float16 beside = (other * 0.5f - floor(other * 0.5f)) - shift;
#else
        const float16 beside = 0;
#endif
        for (int k = -1; k <= 1; ++k) {
            const int16 out = other < 0 || other > last || column + k < 0
                || column + k > (float)(columns - 1);
            const float16 oa = a - k - beside, ob = b - i * ROW_HEIGHT;
            float16 weight;
            if (!filtered_rims(oa, ob, out, radius, per_sample, rim, rim_size, &weight))
                continue;
            cis16(-turns * (oa * oa + ob * ob), &re, &im);
            sum_re += weight * re;
            sum_im += weight * im;
        }
    }
    merge(to, sum_re, sum_im);
}
#endif

__kernel void lenslets(__global cplx *restrict t, __global const real2 *restrict a_of_y,
                       __global const real2 *restrict b_of_y,
                       __global const real2 *restrict a_of_x,
                       __global const real2 *restrict b_of_x, __global const real *restrict turns, const real radius,
                       const real2 turn, const real angle, const real hy, const real hx,
                       __global const real *restrict rim, const int rim_size,
                       const int rows, const int columns, const int ny, const int nx)
{
    const int y = get_global_id(1);
    const size_t row = row_start(0, y, ny, nx);
    const real reach = fabs(hx) + fabs(hy);
    int x = 0;
#if defined(LANES) && defined(FILTERED)
    for (; x + 16 <= nx; x += 16)
        lenslets16((__global float *)(t + row + x), (__global const float *)(a_of_x + x),
                   (__global const float *)(b_of_x + x), a_of_y[y], b_of_y[y], turns[0], radius,
                   0.5f / hx, rim, rim_size, rows, columns);
#endif
    FROM_X(x, nx) {
        const real2 a = a_of_y[y] + a_of_x[x];
        const real2 b = b_of_y[y] + b_of_x[x];
        const Lenslet l = nearest(a, b, rows, columns);
        const real r2 = l.a * l.a + l.b * l.b;
#ifdef FILTERED
        const real per_sample = (real)0.5f / hx, deep = radius - RIM / per_sample;
        if (!(deep > 0 && r2 < deep * deep)) {
            t[row + x] = filtered(l, radius, per_sample, rows, columns, turns, rim, rim_size);
            continue;
        }
#endif
        real amplitude = 1;
        const bool inner = IS_FULL && radius >= (real)0.5f && is_inner(l, rows, columns);
        const real room = radius - reach;
        if (!inner && !(room > 0 && r2 < room * room))
            amplitude = coverage(l, radius, IS_FULL, turn, angle, hx, hy, rows, columns);
        t[row + x] = amplitude * cis_turns(-turns[lens_type(l.row, l.column)] * r2);
    }
}
