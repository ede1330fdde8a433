// A padded propagation step of N x N samples in three passes, M = 2N: rows forward, columns forward
// times H and inverse, rows inverse. A work-group of T = M / 8 items transforms one line: Stockham
// stages, the first of radix R0 (2, 4 or 8), the others of radix 8 (Van Loan 1992, section 1.7).
// Item t holds elements t + q T of the line, q = 0 to 7, before and after a transform.
//
// -D M       length of a line, R0 * 8^n
// -D R0      radix of the first stage
// -D GROUP   columns that lie side by side between the passes
// -D COLUMNS columns that a work-group transforms one after another

typedef float2 C;
#define T (M / 8)
#define N (M / 2)
#define BETWEEN(y, x) (((size_t)((x) / GROUP) * N + (y)) * GROUP + (x) % GROUP)
#define BANK(a) ((a) ^ (((a) >> 5) & 31)) // without bank conflicts
#define HALF_ROOT 0.70710678118654752f
#define EIGHT _Pragma("unroll") for (int q = 0; q < 8; ++q)
#define FENCE barrier(CLK_LOCAL_MEM_FENCE);

inline C times(C a, C b) { return (C)(a.x * b.x - a.y * b.y, a.x * b.y + a.y * b.x); }
inline C over(C a, C b) { return (C)(a.x * b.x + a.y * b.y, a.y * b.x - a.x * b.y); }
#define TWIST(a, w) (INVERSE ? over(a, w) : times(a, w))
#define QUARTER(a) (INVERSE ? (C)(-(a).y, (a).x) : (C)((a).y, -(a).x))
#define EIGHTH(a) \
    (HALF_ROOT * (INVERSE ? (C)((a).x - (a).y, (a).x + (a).y) : (C)((a).x + (a).y, (a).y - (a).x)))

#define BUTTERFLY2(a, b) { const C sum = a + b; b = a - b; a = sum; }
#define BUTTERFLY4(a, b, c, d) { \
    const C s0 = a + c, s1 = a - c, s2 = b + d, s3 = QUARTER(b - d); \
    a = s0 + s2; b = s1 + s3; c = s0 - s2; d = s1 - s3; }
#define BUTTERFLY8 { \
    BUTTERFLY4(v[0], v[2], v[4], v[6]) BUTTERFLY4(v[1], v[3], v[5], v[7]) \
    const C e1 = v[2], e2 = v[4], e3 = v[6]; \
    const C o0 = v[1], o1 = EIGHTH(v[3]), o2 = QUARTER(v[5]), o3 = QUARTER(EIGHTH(v[7])); \
    v[4] = v[0] - o0; v[0] += o0; v[1] = e1 + o1; v[5] = e1 - o1; \
    v[2] = e2 + o2; v[6] = e2 - o2; v[3] = e3 + o3; v[7] = e3 - o3; }

// Results q of a stage go to PLACE(q); items then take theirs. One component at a time: 4 M bytes.
#define EXCHANGE(PLACE) { \
    EIGHT line[BANK(PLACE)] = v[q].x; \
    FENCE EIGHT v[q].x = line[BANK(t + q * T)]; \
    FENCE EIGHT line[BANK(PLACE)] = v[q].y; \
    FENCE EIGHT v[q].y = line[BANK(t + q * T)]; \
    FENCE }

#define TWIDDLES(DONE) { \
    const int e = (t & ((DONE) - 1)) * (M / ((DONE) * 8)); \
    const C w1 = w[e], w2 = w[2 * e], w4 = w[4 * e], w3 = times(w1, w2); \
    v[1] = TWIST(v[1], w1); v[2] = TWIST(v[2], w2); v[3] = TWIST(v[3], w3); \
    v[4] = TWIST(v[4], w4); v[5] = TWIST(v[5], times(w1, w4)); \
    v[6] = TWIST(v[6], times(w2, w4)); v[7] = TWIST(v[7], times(w3, w4)); }
#define STAGE(DONE) TWIDDLES(DONE) BUTTERFLY8 \
    EXCHANGE(t / (DONE) * (DONE) * 8 + (t & ((DONE) - 1)) + q * (DONE))
#define LAST(DONE) TWIDDLES(DONE) BUTTERFLY8

#if R0 == 8
#define FIRST BUTTERFLY8 EXCHANGE(t * 8 + q)
#elif R0 == 4
#define FIRST BUTTERFLY4(v[0], v[2], v[4], v[6]) BUTTERFLY4(v[1], v[3], v[5], v[7]) \
    EXCHANGE((t + (q & 1) * T) * 4 + (q >> 1))
#else
#define FIRST BUTTERFLY2(v[0], v[4]) BUTTERFLY2(v[1], v[5]) BUTTERFLY2(v[2], v[6]) \
    BUTTERFLY2(v[3], v[7]) EXCHANGE((t + (q & 3) * T) * 2 + (q >> 2))
#endif
#if M == R0 * 64
#define TRANSFORM FIRST STAGE(R0) LAST(R0 * 8)
#elif M == R0 * 512
#define TRANSFORM FIRST STAGE(R0) STAGE(R0 * 8) LAST(R0 * 64)
#else
#define TRANSFORM FIRST STAGE(R0) STAGE(R0 * 8) STAGE(R0 * 64) LAST(R0 * 512)
#endif

#define INVERSE 0
__attribute__((reqd_work_group_size(T, 1, 1)))
kernel void rows(global const C *field, global C *between, global const C *w)
{
    local float line[M];
    const int t = get_local_id(0), y = get_group_id(0);
    C v[8];
    EIGHT v[q] = q < 4 ? field[(size_t)y * N + t + q * T] : (C)(0.0f);
    TRANSFORM
    EIGHT between[BETWEEN(y, t + q * T)] = v[q];
}

// H is even in both frequencies; the quadrant lies as H[fx][fy], N + 1 samples each.
__attribute__((reqd_work_group_size(T, 1, 1)))
kernel void columns(global C *between, global const C *H, global const C *w)
{
    local float line[M];
    const int t = get_local_id(0);
    for (int c = 0; c < COLUMNS; ++c) {
        const int x = get_group_id(0) * COLUMNS + c;
        global const C *factor = H + (size_t)min(x, M - x) * (N + 1);
        C v[8];
        EIGHT v[q] = q < 4 ? between[BETWEEN(t + q * T, x)] : (C)(0.0f);
        TRANSFORM
        EIGHT v[q] = times(v[q], factor[min(t + q * T, M - t - q * T)]);
#undef INVERSE
#define INVERSE 1
        TRANSFORM
#undef INVERSE
#define INVERSE 0
        _Pragma("unroll") for (int q = 0; q < 4; ++q) between[BETWEEN(t + q * T, x)] = v[q];
    }
}

#undef INVERSE
#define INVERSE 1
__attribute__((reqd_work_group_size(T, 1, 1)))
kernel void rows_back(global const C *between, global C *field, global const C *w)
{
    local float line[M];
    const int t = get_local_id(0), y = get_group_id(0);
    C v[8];
    EIGHT v[q] = between[BETWEEN(y, t + q * T)];
    TRANSFORM
    _Pragma("unroll") for (int q = 0; q < 4; ++q) field[(size_t)y * N + t + q * T] = v[q];
}
