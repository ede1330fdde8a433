/* Every built-in function of OpenCL that the other kernels call, for single samples in a loop and,
 * where kernels use vectors, for 4, 8 and 16 samples. A compiler is tested with it first, since some
 * compilers crash.
 *
 *   y[f, k] = f(a_k, b_k),  a_k = x[0, k] > 0,  b_k = x[1, k],  k = 0 ... n - 1,  16 divides n
 *
 * The order is that of clplen/compute/drivers/builtin_functions.py. i and j are the integers of a and
 * b; halves, bytes and shorts are the integers of a in the dtypes of stored light fields. A single
 * item computes all.
 *
 * Loops over vectors are not unrolled, which would take compile time without testing more.
 *
 * -DDOUBLE   functions of doubles, too (requires cl_khr_fp64)
 */
#ifdef DOUBLE
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
#endif

#define KEEP(value) *out = (value), out += n

#define SCALARS(FLOAT) \
    for (int k = 0; k < n; ++k) { \
        const FLOAT a = x[k], b = x[n + k]; \
        FLOAT c; \
        const FLOAT s = sincos(a, &c); \
        __global float *out = y + k; \
        KEEP(sqrt(a)); \
        KEEP(exp(b)); \
        KEEP(s); \
        KEEP(c); \
        KEEP(rint(b)); \
        KEEP(floor(b)); \
        KEEP(ceil(b)); \
        KEEP(fabs(b)); \
        KEEP(fmin(a, b)); \
        KEEP(fmax(a, b)); \
        KEEP(clamp(b, a - 1, a)); \
        KEEP(mad(a, b, a)); \
        KEEP(fma(a, b, a)); \
    } \
    y += 13 * n

#define KEEP_ALL(store, value) store(value, 0, out), out += n

#define VECTORS(N, FLOAT, to_float, to_int, load, load_half, store) \
    _Pragma("unroll 1") \
    for (int k = 0; k < n; k += N) { \
        const FLOAT a = load(0, x + k), b = load(0, x + n + k); \
        __global float *out = y + k; \
        KEEP_ALL(store, sqrt(a)); \
        KEEP_ALL(store, rint(b)); \
        KEEP_ALL(store, floor(b)); \
        KEEP_ALL(store, ceil(b)); \
        KEEP_ALL(store, fabs(b)); \
        KEEP_ALL(store, fmin(a, b)); \
        KEEP_ALL(store, fmax(a, b)); \
        KEEP_ALL(store, clamp(b, a - 1, a)); \
        KEEP_ALL(store, mad(a, b, a)); \
        KEEP_ALL(store, fma(a, b, a)); \
        KEEP_ALL(store, select(a, b, to_int(a) > to_int(b))); \
        KEEP_ALL(store, to_float(min(to_int(a), to_int(b)))); \
        KEEP_ALL(store, to_float(max(to_int(a), to_int(b)))); \
        KEEP_ALL(store, to_float(clamp(to_int(b), to_int(a) - 1, to_int(a)))); \
        KEEP_ALL(store, load_half(0, halves + k)); \
        KEEP_ALL(store, to_float(load(0, bytes + k))); \
        KEEP_ALL(store, to_float(load(0, shorts + k))); \
    } \
    y += 17 * n

__kernel void builtins(
    __global float *y, __global const float *x, __global const half *halves,
    __global const uchar *bytes, __global const ushort *shorts, const int n)
{
    SCALARS(float);
    for (int k = 0; k < n; ++k) {
        const float a = x[k], b = x[n + k];
        const int i = (int)a, j = (int)b;
        __global float *out = y + k;
        KEEP(sin(a));
        KEEP(cos(a));
        KEEP(isfinite(a) ? a : b);
        KEEP(any((int2)(i, j) > 2) ? a : b);
        KEEP(abs(j));
        KEEP(min(i, j));
        KEEP(max(i, j));
        KEEP(clamp(j, i - 1, i));
        KEEP(clz((uint)i + 1));
        KEEP(clz((ulong)i + 1));
        KEEP(mul_hi((uint)i, 1u << 31));
        KEEP(dot((float4)(a, b, 1, 2), (float4)(b, 1, a, 2)));
        KEEP(as_float(as_uint(a) ^ 0x80000000u));
        KEEP(vload_half(k, halves));
        *out = b;
        atomic_cmpxchg((volatile __global uint *)out, as_uint(b), as_uint(a));
        out += n;
        *out = a;
        atomic_add((volatile __global uint *)out, as_uint(b) - as_uint(a));
        out += n;
        KEEP(as_ulong(convert_long_rte(b)) + 4);
        const float2 pair = (float2)(a, b);
        const int2 whole = convert_int2(floor(pair));
        KEEP(convert_float2(whole).y + rint(pair).x + sqrt(pair).x + clamp(pair, 0.0f, 1.0f).y);
    }
    y += 18 * n;
    VECTORS(4, float4, convert_float4, convert_int4, vload4, vload_half4, vstore4);
    VECTORS(8, float8, convert_float8, convert_int8, vload8, vload_half8, vstore8);
    VECTORS(16, float16, convert_float16, convert_int16, vload16, vload_half16, vstore16);
    for (int k = 0; k < n; k += 16) {
        const float16 a = vload16(0, x + k), b = vload16(0, x + n + k);
        float16 c;
        const float16 s = sincos(a, &c);
        const float16 turned = as_float16(as_int16(a) ^ (as_int16(a) << 31));
        __global float *out = y + k;
        KEEP_ALL(vstore16, exp(b));
        KEEP_ALL(vstore16, s);
        KEEP_ALL(vstore16, c);
        KEEP_ALL(vstore16, (float16)(a.odd, turned.even));
    }
    y += 4 * n;
#ifdef DOUBLE
    SCALARS(double);
#endif
}
