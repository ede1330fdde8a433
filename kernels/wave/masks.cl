/* Random phase masks from cells: phasors, their spread over the samples, the phase alone.
 *
 *   cell_phasors   t[j, i] = exp(2 pi i r),  r = philox(i/4, j, index, 0; key)[i % 4] / 2^32
 *   spread_rows    s[y, i] = sum_a w[y, a] t[at[y, a], i]         a < TAPS
 *   spread         u[y, x] = sum_b w[x, b] s[y, at[x, b]]         b < TAPS
 *   unit_phase     u      -> u / |u|,  0 -> 1
 *
 * t (my, mx) are the cells, at (n, TAPS) the cells that contribute to a sample and w (n, TAPS) their
 * weights: one tap of 1 for a square cell.
 * Mapping: FOR_X of common.cl, explicit in cell_phasors. -DTAPS; -DROWS, -DDOUBLE: see common.cl.
 */
#include "common.cl"

#ifndef TAPS
#define TAPS 1
#endif

/* Philox4x32-10, a counter-based random generator (Salmon et al. 2011, section 3.3), with equal words
 * on every device; its host version is in clplen/wave/coherence/spatial_models.py. */
inline uint4 philox(uint4 counter, uint2 key)
{
    for (int i = 0; i < 10; ++i) {
        const uint high0 = mul_hi(0xD2511F53u, counter.x), low0 = 0xD2511F53u * counter.x;
        const uint high1 = mul_hi(0xCD9E8D57u, counter.z), low1 = 0xCD9E8D57u * counter.z;
        counter = (uint4)(high1 ^ counter.y ^ key.x, low1, high0 ^ counter.w ^ key.y, low0);
        key += (uint2)(0x9E3779B9u, 0xBB67AE85u);
    }
    return counter;
}

inline cplx phasor(uint word)
{
#ifdef DOUBLE
    return cis_turns(word * 0x1p-32);
#else
    return cis_turns((word >> 8) * 0x1p-24f);
#endif
}

__kernel void cell_phasors(__global cplx *restrict t, const uint index, const uint2 key,
                           const int ny, const int nx)
{
    const int y = get_global_id(1);
    const size_t row = row_start(0, y, ny, nx);
#ifdef ROWS
    for (int x = 0; x < nx; x += 4) {
        const uint4 words = philox((uint4)(x / 4, y, index, 0), key);
        t[row + x] = phasor(words.x);
        if (x + 1 < nx)
            t[row + x + 1] = phasor(words.y);
        if (x + 2 < nx)
            t[row + x + 2] = phasor(words.z);
        if (x + 3 < nx)
            t[row + x + 3] = phasor(words.w);
    }
#else
    const int x = get_global_id(0);
    if (x >= nx)
        return;
    const uint4 words = philox((uint4)(x / 4, y, index, 0), key);
    const uint2 pair = x % 4 < 2 ? words.xy : words.zw;
    t[row + x] = phasor(x % 2 ? pair.y : pair.x);
#endif
}

__kernel void spread_rows(__global cplx *restrict s, __global const cplx *restrict t,
                          __global const int *restrict at, __global const real *restrict w,
                          const int ny, const int nx)
{
    const int y = get_global_id(1);
    const size_t row = row_start(0, y, ny, nx);
    FOR_X(x, nx) {
        cplx sum = (cplx)(0, 0);
        for (int a = 0; a < TAPS; ++a)
            sum += w[y * TAPS + a] * t[(size_t)at[y * TAPS + a] * nx + x];
        s[row + x] = sum;
    }
}

__kernel void spread(__global cplx *restrict u, __global const cplx *restrict s,
                     __global const int *restrict at, __global const real *restrict w,
                     const int cells, const int ny, const int nx)
{
    const int y = get_global_id(1);
    const size_t row = row_start(0, y, ny, nx), from = row_start(0, y, ny, cells);
    FOR_X(x, nx) {
        cplx sum = (cplx)(0, 0);
        for (int b = 0; b < TAPS; ++b)
            sum += w[x * TAPS + b] * s[from + at[x * TAPS + b]];
        u[row + x] = sum;
    }
}

__kernel void unit_phase(__global cplx *restrict u, const int ny, const int nx)
{
    const int y = get_global_id(1);
    const size_t row = row_start(get_global_id(2), y, ny, nx);
    FOR_X(x, nx) {
        const cplx v = u[row + x];
        const real size = sqrt(v.x * v.x + v.y * v.y);
        u[row + x] = size > 0 ? v / size : (cplx)(1, 0);
    }
}
