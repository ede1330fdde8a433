/* Phase of the lenslets of an array relative to thin lenses at the design positions.
 *
 *   t(y, x) = exp(2 pi i (P(b, a) + e0 + e1 a + e2 b + e3 (a^2 + b^2)))
 *
 * (b, a): offset of the sample from the centre of the nearest lenslet, in pitches along the rows'
 * normal and along the rows. P = sum_ik c[i, k] b^i a^k is common to all lenslets, e = own[row, column]
 * specific. Both are in turns, in double precision on the host; P by Horner's rule, abs(a), abs(b) < 1.
 *
 * -DORDER=n         the highest power of P; 0 for none
 * -DHEXAGONAL       see nearest_lenslet.cl
 * -DROWS, -DDOUBLE  see common.cl
 *
 * Mapping: FOR_X of common.cl.
 */
#include "nearest_lenslet.cl"

#ifdef DOUBLE
typedef double4 real4;
#else
typedef float4 real4;
#endif

inline real polynomial(__global const real *restrict c, real a, real b)
{
    real sum = 0;
    for (int i = ORDER; i >= 0; --i) {
        real line = 0;
        for (int k = ORDER - i; k >= 0; --k)
            line = line * a + c[i * (ORDER + 1) + k];
        sum = sum * b + line;
    }
    return sum;
}

__kernel void lenslet_errors(__global cplx *restrict t, __global const real2 *restrict a_of_y,
                             __global const real2 *restrict b_of_y,
                             __global const real2 *restrict a_of_x,
                             __global const real2 *restrict b_of_x, __global const real *restrict c,
                             __global const real4 *restrict own, const int rows, const int columns,
                             const int ny, const int nx)
{
    const int y = get_global_id(1);
    const size_t row = row_start(0, y, ny, nx);
    FOR_X(x, nx) {
        const Lenslet l = nearest(a_of_y[y] + a_of_x[x], b_of_y[y] + b_of_x[x], rows, columns);
        const real4 e = own[l.row * columns + l.column];
        const real each = e.x + e.y * l.a + e.z * l.b + e.w * (l.a * l.a + l.b * l.b);
        t[row + x] = cis_turns(polynomial(c, l.a, l.b) + each);
    }
}
