/* Sums of shifted patterns: sum_j (pattern j) * (comb j), both put on one window and convolved by
 * Fourier transforms.
 *
 *   refine         out[b, ky, kx]  = in[b, ky', kx'], a spectrum in a larger window, 0 beyond
 *   coarsen        out[b, ky', kx'] = in[b, ky, kx], the transpose of refine
 *   pattern        z[y, x]         = gain |u[b, y, x]|^2, 0 outside u
 *   comb           c[y, x]         = sum_rs K(y - y_r) K(x - x_rs) w[r, s]
 *   add_product    sum[y, x]      += a[y, x] b[y, x]
 *   add_part       out[y, x]      += pick.x Re z[o y, o x] + pick.y Im z[o y, o x]
 *
 * comb spreads weights on a lattice with a short kernel K (Kaiser and Bessel's, Jackson et al.
 * 1991): sample y meets rows row[y] + (0 .. tall - 1) with factors down[y], and row r meets columns
 * column[r % kinds, x] + (0 .. wide - 1) with factors across[r % kinds, x]; odd rows of a hexagonal
 * lattice have a table of their own (kinds = 2).
 *
 * Mapping: FOR_X of common.cl over the output. -DROWS, -DDOUBLE: see common.cl.
 */
#include "common.cl"

/* Index in a spectrum of n samples of index k in a spectrum of length samples, -1 beyond it. */
inline int narrower(int k, int length, int n)
{
    if (k < n - n / 2)
        return k;
    const int from_end = length - k;
    return from_end <= n / 2 ? n - from_end : -1;
}

__kernel void refine(__global cplx *restrict out, __global const cplx *restrict in, const int ny,
                     const int nx, const int in_ny, const int in_nx)
{
    const int y = get_global_id(1);
    const int b = get_global_id(2);
    const size_t row = row_start(b, y, ny, nx);
    const int from_y = narrower(y, ny, in_ny);
    const size_t from = row_start(b, max(from_y, 0), in_ny, in_nx);
    FOR_X(x, nx) {
        const int from_x = narrower(x, nx, in_nx);
        out[row + x] = from_y >= 0 && from_x >= 0 ? in[from + from_x] : (cplx)(0);
    }
}

__kernel void coarsen(__global cplx *restrict out, __global const cplx *restrict in, const int ny,
                      const int nx, const int in_ny, const int in_nx)
{
    const int y = get_global_id(1);
    const int b = get_global_id(2);
    const size_t row = row_start(b, y, ny, nx);
    const size_t from = row_start(b, y < ny - ny / 2 ? y : y + in_ny - ny, in_ny, in_nx);
    FOR_X(x, nx)
        out[row + x] = in[from + (x < nx - nx / 2 ? x : x + in_nx - nx)];
}

__kernel void pattern(__global cplx *restrict z, __global const cplx *restrict u, const real gain,
                      const int b, const int ny, const int nx, const int in_ny, const int in_nx)
{
    const int y = get_global_id(1);
    const size_t row = row_start(0, y, ny, nx);
    const size_t from = row_start(b, min(y, in_ny - 1), in_ny, in_nx);
    FOR_X(x, nx) {
        const bool inside = y < in_ny && x < in_nx;
        const cplx v = inside ? u[from + min(x, in_nx - 1)] : (cplx)(0);
        z[row + x] = (cplx)(gain * (v.x * v.x + v.y * v.y), 0);
    }
}

__kernel void comb(__global cplx *restrict c, __global const cplx *restrict w,
                   __global const int *restrict row, __global const real *restrict down,
                   __global const int *restrict column, __global const real *restrict across,
                   const int rows, const int columns, const int kinds, const int tall,
                   const int wide, const int ny, const int nx)
{
    const int y = get_global_id(1);
    const size_t start = row_start(0, y, ny, nx);
    FOR_X(x, nx)
        c[start + x] = (cplx)(0);
    for (int i = 0; i < tall; ++i) {
        const int r = row[y] + i;
        const real ky = down[y * tall + i];
        if (r < 0 || r >= rows || ky == 0)
            continue;
        const int kind = (r % kinds) * nx;
        FOR_X(x, nx) {
            for (int k = 0; k < wide; ++k) {
                const int s = column[kind + x] + k;
                if (s >= 0 && s < columns)
                    c[start + x] += ky * across[(kind + x) * wide + k] * w[r * columns + s];
            }
        }
    }
}

__kernel void add_product(__global cplx *restrict sum, __global const cplx *restrict a,
                          __global const cplx *restrict b, const int ny, const int nx)
{
    const size_t row = row_start(get_global_id(2), get_global_id(1), ny, nx);
    FOR_X(x, nx)
        sum[row + x] += cmul(a[row + x], b[row + x]);
}

__kernel void add_part(__global real *restrict out, __global const cplx *restrict z,
                       const real2 pick, const int step, const int z_nx, const int ny,
                       const int nx)
{
    const int y = get_global_id(1);
    const size_t row = row_start(0, y, ny, nx);
    const size_t from = (size_t)y * step * z_nx;
    FOR_X(x, nx) {
        const cplx v = z[from + (size_t)x * step];
        out[row + x] += pick.x * v.x + pick.y * v.y;
    }
}
