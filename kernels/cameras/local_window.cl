/* The light of single points in windows of their own, about their chief rays.
 *
 * The chief ray of a point meets the array at X with the direction cosines s0. Beside X by xi,
 *
 *   U(X + xi) = exp(i k (s0 xi + xi H xi/2)) sum_j G(s_j) exp(i k s_j xi),
 *
 * H the curvature of waves from the rim of the pupil, which are all that is not stationary. The ray from u in the pupil has the slope t = t0 - q u,
 * q = 1/F', meets the array at xi = (1 - beta) u, and belongs to s = sin(t) - s0 - H xi. The phase
 * of G is that of the ray less those of the factors (stationary phase), its amplitude keeps the
 * energy; for a window at the image (beta = 1) and for small angles this is the exact integral.
 *
 *   spectra     G for each point on a square of samples of s about 0
 *   behind      U in the window times the quadratic phase and the transmission of the array
 *   onward      spectra times the angular spectrum's factor over z3 about the direction of a carrier
 *
 * point: NUMBERS for each point, see `_numbers` of local_window.py.
 * -DTHIN: the quadratic phase of a thin lens; else a lens that images the point without aberrations,
 *         with the amplitude cos^(3/2) in the pupil's plane of the sine condition.
 * -DPATH: the main lens has a wavefront of its own, a table (path/lam, transmission) over the pupil's
 *         square, by Lagrange's cubic.
 * -DSHADOW: screens stop part of the light, a table of complex factors over the same square.
 * -DLANES: sixteen samples at a time (with -DROWS, in float32), in `spectra` those of points without
 *         size, and neither with -DPATH nor -DSHADOW.
 * Mapping: FOR_X of common.cl, axis 2 = point. -DROWS, -DDOUBLE: see common.cl.
 */
#include "common.cl"
#ifdef LANES
#include "lanes.cl"
#endif
#include "disc_pattern.cl"
#include "rim_weights.cl"

#define NUMBERS 18
#define PATH_REACH 1.25f
#define NEWTON 3

/* Weights of Lagrange's cubic at -1, 0, 1, 2. */
inline void lagrange(real t, real *w)
{
    w[0] = -t * (t - 1) * (t - 2) / 6;
    w[1] = (t + 1) * (t - 1) * (t - 2) / 2;
    w[2] = -(t + 1) * t * (t - 2) / 2;
    w[3] = (t + 1) * t * (t - 1) / 6;
}

/* A pair of numbers at (v, u) of the unit disc; the table reaches to PATH_REACH. */
inline real2 from_table(__global const real2 *restrict table, int size, real v, real u)
{
    const real middle = (real)0.5f * (size - 1), step = middle / PATH_REACH;
    const real y = clamp(v * step + middle, (real)1, (real)(size - 2));
    const real x = clamp(u * step + middle, (real)1, (real)(size - 2));
    const int iy = min((int)y, size - 3), ix = min((int)x, size - 3);
    real wy[4], wx[4];
    lagrange(y - iy, wy);
    lagrange(x - ix, wx);
    real2 sum = (real2)(0);
    for (int j = 0; j < 4; ++j)
        for (int i = 0; i < 4; ++i)
            sum += wy[j] * wx[i] * table[(size_t)(iy - 1 + j) * size + ix - 1 + i];
    return sum;
}

#if defined(LANES) && !defined(PATH) && !defined(SHADOW)
/* Sixteen samples of `spectra` at (sy, sx), of a point without size. */
inline void spectra16(__global float *to, __global const real *p, const float sy, const float16 sx,
                      __global const real *rim, const int rim_size, const float R, const float z2,
                      const float ds, const float per_lam)
{
    const float ty0 = p[0], tx0 = p[1], q = p[2], gap = p[3], hyy = p[4], hyx = p[5], hxx = p[6];
    const float t02 = ty0 * ty0 + tx0 * tx0, a0 = sqrt(1 + t02), c0 = 1 / a0;
    const float16 along = ty0 * sy + tx0 * sx;
    float16 uy = -z2 * a0 * (sy + ty0 * along), ux = -z2 * a0 * (sx + tx0 * along);
    const int16 near = uy * uy + ux * ux < 4 * R * R; /* also where the pupil is shifted */
    float16 by, bx, a, apart, det;
    for (int i = 0; i <= NEWTON; ++i) {
        const float16 ty = ty0 - q * uy, tx = tx0 - q * ux;
        apart = q * (q * (uy * uy + ux * ux) - 2 * (ty0 * uy + tx0 * ux)); /* t^2 - t0^2 */
        a = sqrt(1 + ty * ty + tx * tx);
        const float16 c = 1 / a, dc = -apart * c * c0 / (a + a0), qc = q * c, c2 = c * c;
        by = -q * uy * c + ty0 * dc; /* direction from that of the chief ray */
        bx = -q * ux * c + tx0 * dc;
        const float16 oy = by - gap * (hyy * uy + hyx * ux) - sy;
        const float16 ox = bx - gap * (hyx * uy + hxx * ux) - sx;
        const float16 myy = -qc * (1 - c2 * ty * ty) - gap * hyy;
        const float16 mxx = -qc * (1 - c2 * tx * tx) - gap * hxx;
        const float16 myx = qc * c2 * ty * tx - gap * hyx;
        det = myy * mxx - myx * myx;
        if (i < NEWTON) {
            uy -= (mxx * oy - myx * ox) / det;
            ux -= (myy * ox - myx * oy) / det;
        }
    }
    const float16 oy = uy - p[15], ox = ux - p[16], root = sqrt(fabs(det));
    union { float16 v; float one[16]; } weight;
    weight.v = near ? (R - sqrt(oy * oy + ox * ox)) * root / ds : (float16)(-1e9f);
    for (int i = 0; i < 16; ++i)
        weight.one[i] = rim_weight(weight.one[i], rim, rim_size);
    float16 amplitude = weight.v * sqrt(p[11]) / root;
    const float16 ahead = ty0 * uy + tx0 * ux, u2 = uy * uy + ux * ux;
    const float16 bend = hyy * uy * uy + 2 * hyx * uy * ux + hxx * ux * ux;
    float16 turns = gap * per_lam
        * (-ahead * apart * c0 / ((a + a0) * (a + a0)) - q * u2 / (a + a0) - (by * uy + bx * ux)
           + 0.5f * gap * bend);
#ifdef THIN
    const float per_z = p[7], at0 = 1 + a0;
    const float16 vy = uy * per_z + ty0, vx = ux * per_z + tx0, v2 = vy * vy + vx * vx;
    const float16 av = 1 + sqrt(1 + v2), at = 1 + a; /* W of a thin lens */
    turns -= per_lam * 0.5f
        * ((v2 * v2 / (av * av) - t02 * t02 / (at0 * at0)) / per_z
           + (q * u2 - 2 * ahead) * ((t02 + apart) / at + t02 / at0) / (a + a0));
#else
    amplitude *= a0 * sqrt(a0) / (a * sqrt(a));
#endif
    turns += sy * p[9] + sx * p[10];
    float16 re, im;
    const int16 lit = weight.v != 0;
    cis16(lit ? turns : (float16)(0), &re, &im);
    amplitude = lit ? amplitude : (float16)(0);
    merge(to, amplitude * re, amplitude * im);
}
#endif

__kernel void spectra(__global cplx *restrict g, __global const real *restrict points,
                      __global const real2 *restrict disc, const int last, const real per_step,
                      __global const real *restrict rim, const int rim_size,
                      __global const real2 *restrict paths, const int path_size,
                      __global const cplx *restrict shadows, const int shadow_size, const real R,
                      const real z2, const real ds, const real per_lam, const int ny, const int nx)
{
    const int y = get_global_id(1);
    const int n = get_global_id(2);
    const size_t row = row_start(n, y, ny, nx);
    __global const real *p = points + (size_t)n * NUMBERS;
    const real ty0 = p[0], tx0 = p[1], q = p[2], gap = p[3], hyy = p[4], hyx = p[5], hxx = p[6];
    const real per_z = p[7], scale = p[8], down = p[9], right = p[10];
    const real a0 = sqrt(1 + ty0 * ty0 + tx0 * tx0), c0 = 1 / a0, t02 = ty0 * ty0 + tx0 * tx0;
    const real sy = ds * (y - ny / 2);
    int x = 0;
#if defined(LANES) && !defined(PATH) && !defined(SHADOW)
    const float16 lane = (float16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    for (; scale == 0 && x + 16 <= nx; x += 16)
        spectra16((__global float *)(g + row + x), p, sy, (lane + (x - nx / 2)) * ds, rim, rim_size,
                  R, z2, ds, per_lam);
#endif
    FROM_X(x, nx) {
        const real sx = ds * (x - nx / 2);
        const real along = ty0 * sy + tx0 * sx;
        real uy = -z2 * a0 * (sy + ty0 * along), ux = -z2 * a0 * (sx + tx0 * along);
        real by = 0, bx = 0, a = 1, apart = 0, det = 1;
        cplx value = (cplx)(0);
        if (uy * uy + ux * ux < (real)4 * R * R) { /* also where the pupil is shifted */
            for (int i = 0; i <= NEWTON; ++i) {
                const real ty = ty0 - q * uy, tx = tx0 - q * ux;
                apart = q * (q * (uy * uy + ux * ux) - 2 * (ty0 * uy + tx0 * ux)); /* t^2 - t0^2 */
                a = sqrt(1 + ty * ty + tx * tx);
                const real c = 1 / a, dc = -apart * c * c0 / (a + a0);
                by = -q * uy * c + ty0 * dc; /* direction from that of the chief ray */
                bx = -q * ux * c + tx0 * dc;
                const real oy = by - gap * (hyy * uy + hyx * ux) - sy;
                const real ox = bx - gap * (hyx * uy + hxx * ux) - sx;
                const real qc = q * c, c2 = c * c;
                const real myy = -qc * (1 - c2 * ty * ty) - gap * hyy;
                const real mxx = -qc * (1 - c2 * tx * tx) - gap * hxx;
                const real myx = qc * c2 * ty * tx - gap * hyx;
                det = myy * mxx - myx * myx;
                if (i < NEWTON) {
                    uy -= (mxx * oy - myx * ox) / det;
                    ux -= (myy * ox - myx * oy) / det;
                }
            }
            const real cell = ds / sqrt(fabs(det)), oy = uy - p[15], ox = ux - p[16];
            real amplitude = rim_weight((R - sqrt(oy * oy + ox * ox)) / cell, rim, rim_size);
            if (amplitude != 0) {
                const real ahead = ty0 * uy + tx0 * ux, u2 = uy * uy + ux * ux;
                const real bend = hyy * uy * uy + 2 * hyx * uy * ux + hxx * ux * ux;
                real turns = gap * per_lam
                    * (-ahead * apart * c0 / ((a + a0) * (a + a0)) - q * u2 / (a + a0)
                       - (by * uy + bx * ux) + (real)0.5f * gap * bend);
                const real vy = uy * per_z + ty0, vx = ux * per_z + tx0, v2 = vy * vy + vx * vx;
                amplitude *= sqrt(p[11] / fabs(det));
                amplitude *= disc_pattern(scale * sqrt(v2), per_step, disc, last);
#ifdef THIN
                const real av = 1 + sqrt(1 + v2), at = 1 + a, at0 = 1 + a0; /* W of a thin lens */
                turns -= per_lam * (real)0.5f
                    * ((v2 * v2 / (av * av) - t02 * t02 / (at0 * at0)) / per_z
                       + (q * u2 - 2 * ahead) * ((t02 + apart) / at + t02 / at0) / (a + a0));
#else
                amplitude *= a0 * sqrt(a0) / (a * sqrt(a));
#endif
#ifdef PATH
                const real2 path = from_table(paths + (size_t)n * path_size * path_size, path_size,
                                              oy / R, ox / R);
                turns += path.x;
                amplitude *= sqrt(fmax(path.y, (real)0));
#endif
                turns += sy * down + sx * right;
                const cplx phase = cis_turns(turns);
                value = amplitude * phase;
#ifdef SHADOW
                const size_t table = (size_t)n * shadow_size * shadow_size;
                value = cmul(value, from_table(shadows + table, shadow_size, uy / R, ux / R));
#endif
            }
        }
        g[row + x] = value;
    }
}

/* array: the transmission of a region; corners: its sample (y, x) at each window's first one. */
__kernel void behind(__global cplx *restrict u, __global const real *restrict points,
                     __global const cplx *restrict array, __global const int *restrict corners,
                     const int array_nx, const real dx, const real per_lam, const int ny,
                     const int nx)
{
    const int y = get_global_id(1);
    const int n = get_global_id(2);
    const size_t row = row_start(n, y, ny, nx);
    __global const real *p = points + (size_t)n * NUMBERS;
    const real hyx = p[5] * per_lam, hxx = (p[6] - p[14]) * per_lam / 2;
    const real eta = dx * (y - ny / 2) + p[12], left = p[13] - dx * (nx / 2);
    const real of_row = (p[4] - p[14]) * per_lam / 2 * eta * eta;
    const size_t from = (size_t)(corners[2 * n] + y) * array_nx + corners[2 * n + 1];
    int x = 0;
#ifdef LANES
    const float16 step = (float16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15) * dx;
    for (; x + 16 <= nx; x += 16) {
        const float16 xi = step + (dx * x + left);
        float16 re, im, ar, ai;
        cis16(of_row + xi * (hxx * xi + hyx * eta), &re, &im);
        deal((__global const float *)(array + from + x), &ar, &ai);
        __global float *to = (__global float *)(u + row + x);
        times16(to, to, re * ar - im * ai, re * ai + im * ar);
    }
#endif
    FROM_X(x, nx) {
        const real xi = dx * x + left;
        const cplx bend = cis_turns(of_row + xi * (hxx * xi + hyx * eta));
        u[row + x] = cmul(cmul(u[row + x], bend), array[from + x]);
    }
}

/* rows, columns: s (s + 2 s0) and turns of a shift for each bin, of each point; middles: s0^2 and the
 * cosine sqrt(1 - s0^2). The spectrum is 0 beyond propagating waves. */
__kernel void onward(__global cplx *restrict u, __global const real2 *restrict rows,
                     __global const real2 *restrict columns, __global const real2 *restrict middles,
                     const real z_per_lam, const int ny, const int nx)
{
    const int y = get_global_id(1);
    const int n = get_global_id(2);
    const size_t row = row_start(n, y, ny, nx);
    const real2 of_row = rows[(size_t)n * ny + y];
    const real c0 = middles[n].y, left = 1 - middles[n].x - of_row.x;
    __global const real2 *of_columns = columns + (size_t)n * nx;
    int x = 0;
#ifdef LANES
    for (; x + 16 <= nx; x += 16) {
        float16 more, turns, re, im;
        deal((__global const float *)(of_columns + x), &more, &turns);
        const float16 rest = left - more, square = rest > 0 ? rest : 0;
        turns += of_row.y - z_per_lam * (more + of_row.x) / (sqrt(square) + c0);
        cis16(turns, &re, &im);
        re = rest > 0 ? re : 0;
        im = rest > 0 ? im : 0;
        __global float *to = (__global float *)(u + row + x);
        times16(to, to, re, im);
    }
#endif
    FROM_X(x, nx) {
        const real2 of_column = of_columns[x];
        const real rest = left - of_column.x;
        const real turns = of_row.y + of_column.y
            - z_per_lam * (of_column.x + of_row.x) / (sqrt(fmax(rest, (real)0)) + c0);
        u[row + x] = rest > 0 ? cmul(u[row + x], cis_turns(turns)) : (cplx)(0);
    }
}
