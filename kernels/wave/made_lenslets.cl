/* Transmission of real microlens arrays: surfaces, maps, clear gaps.
 *
 *   t(y, x) = A exp(2 pi i (m(b, a) + rim - s(r^2))) + B
 *   s(u) = c u/(1 + sqrt(1 - q u)) + u^2 (e_0 + u (e_1 + ...))
 *
 * (a, b): offset of the sample from the centre of the nearest lenslet along the array's columns and
 * rows, r its length, in pitches; s, m, rim in turns. c = (n - 1) pitch^2/(lam R), q = (1 + K)
 * pitch^2/R^2 and e of the lenslet's kind are those of a conic section with even powers (ISO
 * 10110-12, eq. 3); a thin lens has c = pitch^2/(lam f), q = 0. m is a map with separate samples,
 * interpolated by cubic convolution (Keys 1981), common to all lenslets or one for each; two samples
 * are added on each side. A is the fraction of the sample's cell that apertures cover, B the fraction
 * of the gaps between discs within the array's cells.
 *
 * shapes[kind] = (c, q, rim, e_0, ...) in double precision on the host. If the device has float64,
 * everything but the result is in float64; float32 has an error of 8e-7 rad per turn.
 *
 * -DHEXAGONAL       see nearest_lenslet.cl
 * -DFULL            the aperture is the lattice cell (square or hexagon); a disc otherwise
 * -DTYPES=n, -DTYPE_STEP=s  see lens_types.cl
 * -DPOWERS=n        number of even powers from r^4 on
 * -DMAP             there is a map
 * -DCLEAR           gaps are clear
 * -DRESULT=         type of a complex result: float2 or double2
 * -DROWS, -DDOUBLE  see common.cl
 *
 * Mapping: FOR_X of common.cl.
 */
#include "lens_types.cl"
#include "lenslet_coverage.cl"

#ifdef FULL
#define IS_FULL true
#else
#define IS_FULL false
#endif

/* Cubic convolution at t from its second sample to its third, 0 <= t <= 1. */
inline real cubic(real p, real q, real r, real s, real t)
{
    return q + t * ((r - p) / 2 + t * ((2 * p - 5 * q + 4 * r - s) / 2
        + t * (3 * (q - r) + s - p) / 2));
}

/* Map at a position in its samples. */
inline real mapped(__global const real *restrict map, real row, real column, int height, int width)
{
    const real y = clamp(row, (real)1.5f, height - (real)2.5f);
    const real x = clamp(column, (real)1.5f, width - (real)2.5f);
    const int i = (int)y, k = (int)x;
    real lines[4];
    for (int j = 0; j < 4; ++j) {
        __global const real *restrict line = map + (size_t)(i - 1 + j) * width + k - 1;
        lines[j] = cubic(line[0], line[1], line[2], line[3], x - k);
    }
    return cubic(lines[0], lines[1], lines[2], lines[3], y - i);
}

__kernel void made_lenslets(__global RESULT *restrict t, __global const real2 *restrict a_of_y,
                            __global const real2 *restrict b_of_y,
                            __global const real2 *restrict a_of_x,
                            __global const real2 *restrict b_of_x,
                            __global const real *restrict shapes, __global const real *restrict map,
                            const real radius, const real2 turn, const real angle, const real hy,
                            const real hx, const real2 per, const real2 zero, const int each,
                            const int height, const int width, const int rows, const int columns,
                            const int ny, const int nx)
{
    const int y = get_global_id(1);
    const size_t start = row_start(0, y, ny, nx);
    const real reach = fabs(hx) + fabs(hy);
    FOR_X(x, nx) {
        const Lenslet l = nearest(a_of_y[y] + a_of_x[x], b_of_y[y] + b_of_x[x], rows, columns);
        const real u = l.a * l.a + l.b * l.b;
        __global const real *restrict shape = shapes + (3 + POWERS) * lens_type(l.row, l.column);
        real higher = 0;
        for (int i = POWERS - 1; i >= 0; --i)
            higher = higher * u + shape[3 + i];
        const real root = sqrt(fmax(1 - shape[1] * u, (real)0));
        real turns = shape[2] - (shape[0] * u / (1 + root) + u * u * higher);
#ifdef MAP
        const size_t first = (size_t)each * ((size_t)l.row * columns + l.column) * height * width;
        turns += mapped(map + first, l.b * per.x + zero.x, l.a * per.y + zero.y, height, width);
#endif
        real amplitude = 1, gap = 0;
        const bool inner = is_inner(l, rows, columns);
        const real room = radius - reach;
        if (!(IS_FULL && inner && radius >= (real)0.5f) && !(room > 0 && u < room * room)) {
            amplitude = coverage(l, radius, IS_FULL, turn, angle, hx, hy, rows, columns);
#ifdef CLEAR
            const real cells = inner ? 1 : coverage(l, (real)0.5f, true, turn, angle, hx, hy, rows,
                                                    columns);
            gap = fmax(cells - amplitude, (real)0);
#endif
        }
        const cplx lens = cis_turns(turns);
        t[start + x] = (RESULT)(amplitude * lens.x + gap, amplitude * lens.y);
    }
}
