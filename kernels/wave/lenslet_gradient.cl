/* Derivatives with respect to the lenslets of an array: sums over the samples of each lenslet, and
 * their transpose, the change of the transmission.
 *
 * lenslets.cl multiplies by t = A exp(i p), p = -2 pi turns (a^2 + b^2) of the nearest lenslet; G is the
 * gradient with respect to t (transmission_gradient.cl), c = exp(-i p) G. The sums are
 *
 *   A Im(c) (a, b, a^2 + b^2)                         of samples with this nearest lenslet
 *   Re(c) d(share)/d(x, y, angle, radius)             of samples that its aperture covers partly
 *
 * lenslet_tangent: dt[p] = exp(i p) sum over lenslets of rates[p, lenslet, 0..6] times the terms above,
 * with i for Im(c) in the first three and 1 for Re(c) in the other four.
 *
 * The share is that of lenslet_coverage.cl, whose strips and clipped polygons are differentiated. A
 * disc's strip grows at its ends inside the cell; a side of a cell moves along its normal and counts by
 * its length in the sample's cell. A side on the border of two samples counts half in each. A sample
 * at equal distance from several lenslets of a kind has the mean slope of their phases. Derivatives
 * at such points are means of the one-sided derivatives.
 * Lengths are in pitches; x, y and angle of the aperture in the sensor's axes. boxes, parts, out: see
 * lenslet_sums.cl.
 *
 * -DHEXAGONAL, -DFULL, -DTYPES=n, -DTYPE_STEP=s   see lenslets.cl
 * -DSAMPLE=float2                                 G and dt in float32 with sums in float64
 * -DDOUBLE                                        see common.cl
 *
 * Mapping: one item per part of a lenslet, axis 0; lenslet_tangent: FOR_X of common.cl, dt zeroed.
 */
#include "lens_types.cl"
#include "lenslet_coverage.cl"
#define SUMS 7
#include "lenslet_sums.cl"

#ifdef DOUBLE
typedef double4 real4;
#define ROUNDING 1e-9 /* rounding of positions, in half cells */
#define ALIKE 1e-10  /* tolerance of equal squared distances, in pitches */
#else
typedef float4 real4;
#define ROUNDING 1e-4f
#define ALIKE 3e-7f
#endif

#ifndef SAMPLE
#define SAMPLE cplx
#endif

#ifdef FULL
#define IS_FULL true
#else
#define IS_FULL false
#endif

/* Derivatives of the chords of a cell's strips by a disc's position along and across and its radius. */
inline real4 strips_change(real along, real across, real R, real ha, real hs)
{
    real4 change = (real4)(0);
    for (int i = 0; i < STRIPS; ++i) {
        const real t = across + hs * ((2 * i + 1) / (real)STRIPS - 1);
        const real square = R * R - t * t;
        if (square <= 0)
            continue;
        const real half_chord = sqrt(square);
        if (fmin(along + half_chord, ha) <= fmax(along - half_chord, -ha))
            continue;
        const int right = along + half_chord < ha, left = along - half_chord > -ha;
        change.x += right - left;
        change.y -= (right + left) * t / half_chord;
        change.w += (right + left) * R / half_chord;
    }
    return change / (2 * ha * STRIPS);
}

/* Derivatives of a cell's share by a disc's (x, y, angle, radius); see disc_coverage. */
inline real4 disc_change(real cx, real cy, real R, real hx, real hy)
{
    const real ax = fabs(cx), ay = fabs(cy);
    const real nx = fmax(ax - hx, (real)0), ny = fmax(ay - hy, (real)0);
    if ((ax + hx) * (ax + hx) + (ay + hy) * (ay + hy) <= R * R || nx * nx + ny * ny >= R * R)
        return (real4)(0);
    const real lean = ax * hy - ay * hx; /* 0: strips turn when the disc moves */
    const real level = fabs(lean) <= ALIKE * hy ? (real)0.5f : lean > 0 ? (real)1 : (real)0;
    real4 change = (real4)(0);
    if (level > 0)
        change += level * strips_change(ax, ay, R, hx, hy);
    if (level < 1)
        change += (1 - level) * strips_change(ay, ax, R, hy, hx).yxzw;
    return change * (real4)(cx < 0 ? -1 : 1, cy < 0 ? -1 : 1, 1, 1);
}

/* Part of a line p + s d in [-h, h] along an axis, and its share that counts. */
inline real clip(real p, real d, real h, real reach, real2 *part)
{
    if (fabs(d) * reach <= ROUNDING * h) {
        const real beyond = fabs(p) - h;
        return beyond > ROUNDING * h ? (real)0 : beyond < -ROUNDING * h ? (real)1 : (real)0.5f;
    }
    const real first = (-h - p) / d, last = (h - p) / d;
    (*part).x = fmax((*part).x, fmin(first, last));
    (*part).y = fmin((*part).y, fmax(first, last));
    return 1;
}

/* Derivatives of a cell's share by a regular polygon of inradius a; see polygon_coverage. */
inline real4 polygon_change(real cx, real cy, real a, int sides, real turn, real hx, real hy)
{
    const real reach = a * (sides == 6 ? 1 / sqrt((real)3) : (real)1);
    real4 change = (real4)(0);
    for (int side = 0; side < sides; ++side) {
        real nx;
        const real ny = sincos(turn + TWO_PI * side / sides, &nx);
        real2 part = (real2)(-reach, reach);
        real share = clip(cx + a * nx, -ny, hx, reach, &part);
        share *= clip(cy + a * ny, nx, hy, reach, &part);
        const real length = share * (part.y - part.x);
        if (length > 0)
            change += length * (real4)(nx, ny, -(part.x + part.y) / 2, 1);
    }
    return change / (4 * hx * hy);
}

/* Number of lenslets of a kind at the distance of the nearest lenslet, including it. */
inline int alike(Lenslet l, real r2, int rows, int columns)
{
    int count = 0;
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
            if (column < 0 || column >= columns
                || lens_type(row, column) != lens_type(l.row, l.column))
                continue;
            const real a = l.a - k - shift, b = l.b - i * ROW_HEIGHT;
            count += a * a + b * b - r2 <= ALIKE;
        }
    }
    return count;
}

__kernel void lenslet_gradient(__global real *restrict out, __global const SAMPLE *restrict G,
                               __global const real2 *restrict a_of_y,
                               __global const real2 *restrict b_of_y,
                               __global const real2 *restrict a_of_x,
                               __global const real2 *restrict b_of_x,
                               __global const int4 *restrict boxes,
                               __global const real *restrict turns, const real radius,
                               const real2 turn, const real angle, const real hy, const real hx,
                               const int parts, const int rows, const int columns, const int nx)
{
    const int item = get_global_id(0);
    if (item >= rows * columns * parts)
        return;
    const int4 box = boxes[item / parts];
    const int row = item / parts / columns, column = item / parts % columns;
    const real room = radius - (hx + hy);
#ifdef HEXAGONAL
    const real shift = (row & 1) * (real)0.5f;
#else
    const real shift = 0;
#endif
    real total[SUMS], lost[SUMS], line[SUMS];
    for (int k = 0; k < SUMS; ++k)
        total[k] = lost[k] = 0;
    for (int y = box.x + item % parts; y < box.y; y += parts) {
        for (int k = 0; k < SUMS; ++k)
            line[k] = 0;
        for (int x = box.z; x < box.w; ++x) {
            const real2 a = a_of_y[y] + a_of_x[x], b = b_of_y[y] + b_of_x[x];
            const Lenslet l = nearest(a, b, rows, columns);
            if (abs(l.row - row) > 1 || abs(l.column - column) > 1)
                continue; /* no neighbour contributes to its sample, see coverage() */
            const real da = ((a.x - column) + a.y) - shift;
            const real db = ((b.x - row) + b.y) * ROW_HEIGHT;
            const real r2 = l.a * l.a + l.b * l.b, d2 = da * da + db * db;
            const int kind = lens_type(l.row, l.column);
            const SAMPLE sample = G[row_start(0, y, 0, nx) + x];
            const cplx c = cmul(cis_turns(turns[kind] * r2), (cplx)(sample.x, sample.y));
            real part = l.row == row && l.column == column; /* share of the sample's phase */
            if (r2 > (real)0.2499f && d2 - r2 <= ALIKE && lens_type(row, column) == kind)
                part = (real)1 / alike(l, r2, rows, columns);
            real amplitude = 1;
            if (!(room > 0 && r2 < room * room)) {
                const real cx = -(da * turn.x - db * turn.y), cy = -(da * turn.y + db * turn.x);
                const real4 change = IS_FULL
                    ? polygon_change(cx, cy, radius, SIDES, angle, hx, hy)
                    : disc_change(cx, cy, radius, hx, hy);
                line[3] += c.x * change.x;
                line[4] += c.x * change.y;
                line[5] += c.x * change.z;
                line[6] += c.x * change.w;
                if (part > 0 && !(IS_FULL && radius >= (real)0.5f && is_inner(l, rows, columns)))
                    amplitude = coverage(l, radius, IS_FULL, turn, angle, hx, hy, rows, columns);
            }
            if (part > 0) {
                const real p = part * amplitude * c.y;
                line[0] += p * da;
                line[1] += p * db;
                line[2] += p * d2;
            }
        }
        add_line(total, lost, line);
    }
    for (int k = 0; k < SUMS; ++k)
        out[(size_t)item * SUMS + k] = total[k];
}

/* dt[p] += exp(i phase) (share + i turn) of a lenslet, for all count sets of rates of `of_all` lenslets. */
inline void add_rates(__global SAMPLE *restrict dt, __global const real *restrict rates,
                      const int lenslet, const int of_all, const int count, const size_t plane,
                      const cplx phase, const real phase_a, const real phase_b,
                      const real phase_square, const real4 change)
{
    for (int p = 0; p < count; ++p) {
        __global const real *r = rates + ((size_t)p * of_all + lenslet) * SUMS;
        const real turn = r[0] * phase_a + r[1] * phase_b + r[2] * phase_square;
        const real share = r[3] * change.x + r[4] * change.y + r[5] * change.z + r[6] * change.w;
        const cplx dt_of_one = cmul(phase, (cplx)(share, turn));
        dt[p * plane] += (SAMPLE)(dt_of_one.x, dt_of_one.y);
    }
}

__kernel void lenslet_tangent(__global SAMPLE *restrict dt, __global const real *restrict rates,
                              __global const real2 *restrict a_of_y,
                              __global const real2 *restrict b_of_y,
                              __global const real2 *restrict a_of_x,
                              __global const real2 *restrict b_of_x,
                              __global const real *restrict turns, const real radius,
                              const real2 turn, const real angle, const real hy, const real hx,
                              const int count, const int rows, const int columns, const int ny,
                              const int nx)
{
    const int y = get_global_id(1);
    const size_t line = row_start(0, y, ny, nx), plane = (size_t)ny * nx;
    const real room = radius - (hx + hy);
    FOR_X(x, nx) {
        const real2 a = a_of_y[y] + a_of_x[x], b = b_of_y[y] + b_of_x[x];
        const Lenslet l = nearest(a, b, rows, columns);
        const real r2 = l.a * l.a + l.b * l.b;
        const int kind = lens_type(l.row, l.column);
        const cplx phase = cis_turns(-turns[kind] * r2);
        const bool rim = !(room > 0 && r2 < room * room);
        real amplitude = 1;
        if (rim && !(IS_FULL && radius >= (real)0.5f && is_inner(l, rows, columns)))
            amplitude = coverage(l, radius, IS_FULL, turn, angle, hx, hy, rows, columns);
        const real shared = r2 > (real)0.2499f ? (real)1 / alike(l, r2, rows, columns) : (real)1;
        const int far = rim || shared < 1 ? 1 : 0;
        for (int row = max(l.row - far, 0); row <= min(l.row + far, rows - 1); ++row) {
#ifdef HEXAGONAL
            const real shift = (row & 1) * (real)0.5f;
#else
            const real shift = 0;
#endif
            const real db = ((b.x - row) + b.y) * ROW_HEIGHT;
            const int first = max(l.column - far, 0), last = min(l.column + far, columns - 1);
            for (int column = first; column <= last; ++column) {
                const real da = ((a.x - column) + a.y) - shift;
                const real d2 = da * da + db * db;
                real part = row == l.row && column == l.column;
                if (r2 > (real)0.2499f && d2 - r2 <= ALIKE && lens_type(row, column) == kind)
                    part = shared;
                real4 change = (real4)(0);
                if (rim) {
                    const real cx = -(da * turn.x - db * turn.y);
                    const real cy = -(da * turn.y + db * turn.x);
                    change = IS_FULL ? polygon_change(cx, cy, radius, SIDES, angle, hx, hy)
                                     : disc_change(cx, cy, radius, hx, hy);
                }
                const real lit = part * amplitude;
                add_rates(dt + line + x, rates, row * columns + column, rows * columns, count, plane,
                          phase, lit * da, lit * db, lit * d2, change);
            }
        }
    }
}
