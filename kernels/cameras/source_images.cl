/* Images of mutually incoherent sources as a linear map of their energies, and its transpose; the
 * light that runs back through a camera, and what it tells of the places of points.
 *
 *   add_images    out[b, oy + y, ox + x] += sum_n w[b, n] I[n, y, x]
 *   image_rows    s[b, n, y] = sum_x I[n, y, x] Y[b, oy_n + y, ox_n + x]    compensated (Kahan 1965)
 *   cotangent     h[n, y, x] = 2 conj(u[n, y, x]) sum_f w[f, n] Y[f, y, x]
 *   conjugate     out[b, y, x] = conj(in[b, y, x])
 *   point_rows    s[n, y, :] = sums over x of Re(h de/dp), p = (x0, y0, z) of point n, and of
 *                 -2 pi Im(h e) plate[y, x]; see source.cl for e = e0 2 J1(v)/v, e0 = A exp(i phase)
 *
 * Images have one shape; shapes: (height, width) of each that count; places: pixel (y, x) of Y or
 * out under their first one. cotangent: conj of the gradient of L with respect to u, Y = dL/d|u|^2.
 * point_rows: with r^2 = rho^2 + z^2, v = scale rho and D(v) = 2 J1(v)/v,
 *
 *   de/dx0 = -dx (i k/r D + scale^2 D'/v) e0,  de/dz = (-i k rho^2/(r (r + z)) D - D' v/z) e0,
 *
 * less 2 less[n] D D' dv/dp |e0|^2, by which the energy of a source of some size changes. plate:
 * turns a metre of the image (y, x), by which the wavefront of the main lens changes.
 * -DSIZE: sources of some size; -DFIELD: with plates.
 * Mapping: FOR_X of common.cl, axis 2 = batch; image_rows and point_rows: one item a row.
 * -DROWS, -DDOUBLE: see common.cl.
 */
#include "disc_pattern.cl"

#ifdef DOUBLE
typedef double4 real4;
#else
typedef float4 real4;
#endif

#define CHAINS 8 /* sums side by side, which compilers join in vectors */

/* term added to *sum with what was lost before (Kahan). */
inline void keep(real term, real *sum, real *lost)
{
    const real exact = term - *lost;
    const real next = *sum + exact;
    *lost = (next - *sum) - exact;
    *sum = next;
}

__kernel void add_images(__global real *restrict out, __global const real *restrict images,
                         __global const real *restrict w, const int first, const int count,
                         const int of_all, const int oy, const int ox, const int out_ny,
                         const int out_nx, const int in_ny, const int in_nx, const int nx)
{
    const int y = get_global_id(1);
    const int b = get_global_id(2);
    const size_t row = row_start(b, oy + y, out_ny, out_nx) + ox;
    for (int n = first; n < first + count; ++n) {
        const size_t from = row_start(n, y, in_ny, in_nx);
        const real weight = w[(size_t)b * of_all + n];
        FOR_X(x, nx)
            out[row + x] += weight * images[from + x];
    }
}

__kernel void image_rows(__global real *restrict out, __global const real *restrict images,
                         __global const real *restrict Y, __global const int2 *restrict places,
                         __global const int2 *restrict shapes, const int count, const int out_ny,
                         const int out_nx, const int ny, const int nx)
{
    const int y = get_global_id(0);
    const int n = get_global_id(1);
    const int b = get_global_id(2);
    if (y >= ny)
        return;
    real sums[CHAINS] = {0}, lost[CHAINS] = {0};
    if (y < shapes[n].x) {
        const size_t from = row_start(n, y, ny, nx);
        const size_t at = row_start(b, places[n].x + y, out_ny, out_nx) + places[n].y;
        const int width = shapes[n].y;
        int x = 0;
        for (; x + CHAINS <= width; x += CHAINS)
            for (int i = 0; i < CHAINS; ++i)
                keep(images[from + x + i] * Y[at + x + i], sums + i, lost + i);
        for (; x < width; ++x)
            keep(images[from + x] * Y[at + x], sums, lost);
    }
    for (int i = 1; i < CHAINS; ++i)
        keep(sums[i], sums, lost);
    out[((size_t)b * count + n) * ny + y] = sums[0];
}

__kernel void cotangent(__global cplx *restrict h, __global const cplx *restrict u,
                        __global const real *restrict Y, __global const real *restrict w,
                        const int filters, const int count, const int ny, const int nx)
{
    const int y = get_global_id(1);
    const int n = get_global_id(2);
    const size_t row = row_start(n, y, ny, nx);
    FOR_X(x, nx) {
        real sum = 0;
        for (int f = 0; f < filters; ++f)
            sum += w[(size_t)f * count + n] * Y[row_start(f, y, ny, nx) + x];
        const cplx v = u[row + x];
        h[row + x] = (cplx)(2 * sum * v.x, -2 * sum * v.y);
    }
}

__kernel void conjugate(__global cplx *restrict out, __global const cplx *restrict in, const int ny,
                        const int nx)
{
    const size_t row = row_start(get_global_id(2), get_global_id(1), ny, nx);
    FOR_X(x, nx)
        out[row + x] = (cplx)(in[row + x].x, -in[row + x].y);
}

/* D' of disc_pattern: the slope of the same interpolation. */
inline real disc_slope(real v, real per_step, __global const real2 *restrict table, int last)
{
    const real place = v * per_step;
    const int i = min((int)place, last - 1);
    const real t = place - i;
    const real2 a = table[i], b = table[i + 1];
    const real rise = b.x - a.x;
    const real slope = a.y
        + t * (2 * (3 * rise - 2 * a.y - b.y) + 3 * t * (a.y + b.y - 2 * rise));
    return place < last ? slope * per_step : 0;
}

/* source: (z, scale, less, -) of each point; down, right: of its foot to rows and columns. */
__kernel void point_rows(__global real *restrict out, __global const cplx *restrict h,
                         __global const cplx *restrict e0, __global const real4 *restrict source,
                         __global const real *restrict down, __global const real *restrict right,
                         __global const real2 *restrict table, const int last, const real per_step,
                         __global const real2 *restrict plate, const real k, const int ny,
                         const int nx)
{
    const int y = get_global_id(0);
    const int n = get_global_id(1);
    if (y >= ny)
        return;
    const size_t row = row_start(n, y, ny, nx);
    const real z = source[n].x, scale = source[n].y, less = source[n].z;
    const real dy = down[(size_t)n * ny + y];
    real sums[5] = {0}, lost[5] = {0};
    for (int x = 0; x < nx; ++x) {
        const cplx e = e0[row + x], q = cmul(h[row + x], e);
        const real dx = right[(size_t)n * nx + x];
        const real rho2 = dx * dx + dy * dy, r = sqrt(rho2 + z * z);
        real D = 1;
#ifdef SIZE
        const real v = scale * sqrt(rho2);
        D = disc_pattern(v, per_step, table, last);
        const real slope = disc_slope(v, per_step, table, last);
        const real on_disc = (q.x - 2 * less * D * (e.x * e.x + e.y * e.y)) * slope;
        const real across = v > 0 ? -scale * scale / v * on_disc : (real)0;
#else
        const real on_disc = 0, across = 0, v = 0;
#endif
        const real turned = D * k * q.y / r; /* Re(i k D q)/r = -turned */
        keep(dx * (turned + across), sums + 0, lost + 0);
        keep(dy * (turned + across), sums + 1, lost + 1);
        keep(turned * rho2 / (r + z) - on_disc * v / z, sums + 2, lost + 2);
#ifdef FIELD
        const real2 turns = plate[row_start(0, y, ny, nx) + x];
        keep(-TWO_PI * D * q.y * turns.x, sums + 3, lost + 3);
        keep(-TWO_PI * D * q.y * turns.y, sums + 4, lost + 4);
#endif
    }
    for (int i = 0; i < 5; ++i)
        out[((size_t)n * ny + y) * 5 + i] = sums[i];
}
