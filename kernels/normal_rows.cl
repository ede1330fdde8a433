/* normal of refine.cl in vectors of sixteen samples, for CPUs and light fields of one or three channels.
 *
 *   A = mean of w (g - <g>)^2, B = mean of w (g - <g>) (r - <r>) + A (d - plane)
 *
 * An item is 16 pixels of a row: one plane next to any wanted one of them after the other, for all.
 *
 * -DSAMPLE=uchar | ushort | half | float, -DLANES=16, -DCHANNELS=1 | 3
 */
#include "common.cl"
#include "strips.cl"

#define GROUPS 9
#define TERMS (5 + 2 * CHANNELS) /* seen, cost, sum w, sum w g^2, sum w g r; w g and w r */

/* The channels of 16 pixels, each by itself. */
inline void by_channel(float16 *value)
{
#if CHANNELS == 3
    const float16 a = value[0], b = value[1], c = value[2];
    value[0] = CHANNEL_0(a, b, c);
    value[1] = CHANNEL_1(a, b, c);
    value[2] = CHANNEL_2(a, b, c);
#endif
}

/* Samples of 16 pixels of a moved view and their derivative by disparity, channel by channel. */
inline void along_rows(float16 *value, float16 *slope, __global const SAMPLE *view, const int row,
                       const int column, const float4 down, const float4 across,
                       const float4 down_slope, const float4 across_slope, const float2 step,
                       const int ny, const int nx)
{
    const strip sum = strip_of(view, row - 1, down, ny, nx);
    strip change = sum;
    change.taps = down_slope;
    const int first = (column - 1) * CHANNELS;
    float16 a = strip_load(sum, first), da = strip_load(change, first);
    for (int j = 0; j < CHANNELS; ++j) {
        const float16 b = strip_load(sum, first + 16 * (j + 1));
        const float16 db = strip_load(change, first + 16 * (j + 1));
        value[j] = across_taps(across, a, b);
        slope[j] = (float16)(step.x) * across_taps(across, da, db)
                   + (float16)(step.y) * across_taps(across_slope, a, b);
        a = b;
        da = db;
    }
    by_channel(value);
    by_channel(slope);
}

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void normal_rows(__global float *restrict A, __global float *restrict B,
                          __global const SAMPLE *restrict L, __global const uchar *restrict wanted,
                          __global const float *restrict disparity,
                          __global const int *restrict nearest, __global const float *restrict planes,
                          __global const int *restrict view, __global const float2 *restrict step,
                          __global const int2 *restrict at, __global const float4 *restrict part,
                          __global const float4 *restrict slopes, __global const int2 *restrict reach,
                          __global const int *restrict first, __global const float *restrict pattern,
                          const int patterns, __global const int *restrict reference,
                          __global const float *restrict share, const int references,
                          const int views, const int ny, const int nx, const float tau,
                          const float ratio, const float margin)
{
    const int x0 = get_global_id(0) * 16, y = get_global_id(1);
    if (x0 >= nx)
        return;
    const int n = min(16, nx - x0);
    const size_t start = row_start(0, y, ny, nx) + x0;
    const size_t size = (size_t)ny * nx * CHANNELS;
    const float16 none = (float16)(0.0f), one = (float16)(1.0f), most_cost = (float16)(tau);
    const int16 column = LANE + (int16)(x0);
    float16 centre[CHANNELS], value[CHANNELS], slope[CHANNELS];
    float16 groups[GROUPS * TERMS], terms[TERMS];
    float most[GROUPS];
    int todo[16];
    for (int x = 0; x < 16; ++x)
        todo[x] = x < n && wanted[start + min(x, n - 1)];

    for (int lead = 0; lead < n; ++lead) {
        if (!todo[lead])
            continue;
        const int plane = nearest[start + lead], table = plane * views;
        for (int c = 0; c < CHANNELS; ++c)
            centre[c] = none;
        for (int r = 0; r < references; ++r) {
            const int v = reference[r], k = table + v;
            along_rows(value, slope, L + view[v] * size, y + at[k].x, x0 + at[k].y, part[2 * k],
                       part[2 * k + 1], slopes[2 * k], slopes[2 * k + 1], step[v], ny, nx);
            for (int c = 0; c < CHANNELS; ++c)
                centre[c] += (float16)(share[r]) * value[c];
        }
        for (int j = 0; j < GROUPS * TERMS; ++j)
            groups[j] = none;
        for (int j = 0; j < GROUPS; ++j)
            most[j] = 0;
        for (int g = 0; g < patterns; ++g) {
            for (int t = 0; t < TERMS; ++t)
                terms[t] = none;
            for (int v = first[g]; v < first[g + 1]; ++v) {
                const int k = table + v;
                const int row = y + at[k].x;
                if (row < 0 || row + reach[k].x >= ny)
                    continue;
                const int16 place = column + (int16)(at[k].y);
                const int16 sees = place >= (int16)(0) & place + (int16)(reach[k].y) < (int16)(nx);
                along_rows(value, slope, L + view[v] * size, row, x0 + at[k].y, part[2 * k],
                           part[2 * k + 1], slopes[2 * k], slopes[2 * k + 1], step[v], ny, nx);
                float16 e = none;
                for (int c = 0; c < CHANNELS; ++c) {
                    value[c] -= centre[c];
                    e += magnitude(value[c]);
                }
                e = e < most_cost ? e : most_cost;
                const float16 u = e / most_cost, rest = one - u * u;
                const float16 w = sees ? rest * rest : none;
                terms[0] += sees ? one : none;
                terms[1] += sees ? e : none;
                terms[2] += w;
                for (int c = 0; c < CHANNELS; ++c) {
                    const float16 pulled = w * slope[c];
                    terms[3] += pulled * slope[c];
                    terms[4] += pulled * value[c];
                    terms[5 + c] += pulled;
                    terms[5 + CHANNELS + c] += w * value[c];
                }
            }
            for (int j = 0; j < GROUPS; ++j) {
                const float w = pattern[g * GROUPS + j];
                most[j] += w * (first[g + 1] - first[g]);
                if (w != 0)
                    for (int t = 0; t < TERMS; ++t)
                        groups[j * TERMS + t] += (float16)(w) * terms[t];
            }
        }
        float16 sum[TERMS];
        for (int t = 0; t < TERMS; ++t)
            sum[t] = groups[t];
        float16 least = sum[0] > none ? sum[1] / sum[0] : most_cost;
        for (int j = 1; j < GROUPS; ++j) {
            const float16 count = groups[j * TERMS];
            const float16 mean = (float16)(ratio) * groups[j * TERMS + 1] / count + (float16)(margin);
            const int16 better = count > none & count >= (float16)(0.5f * most[j]) & mean < least;
            least = better ? mean : least;
            for (int t = 0; t < TERMS; ++t)
                sum[t] = better ? groups[j * TERMS + t] : sum[t];
        }
        union { float16 v; float s[16]; } a, b;
        a.v = sum[3];
        b.v = sum[4];
        const float16 weight = sum[2] > none ? sum[2] : one;
        for (int c = 0; c < CHANNELS; ++c) { /* without a weight these sums are 0 */
            a.v -= sum[5 + c] * sum[5 + c] / weight;
            b.v -= sum[5 + c] * sum[5 + CHANNELS + c] / weight;
        }
        const float16 count = sum[0] > none ? sum[0] : one;
        a.v = (a.v > none ? a.v : none) / count;
        b.v = b.v / count;
        for (int x = lead; x < n; ++x)
            if (todo[x] && nearest[start + x] == plane) {
                A[start + x] = a.s[x];
                B[start + x] = b.s[x] + a.s[x] * (disparity[start + x] - planes[plane]);
                todo[x] = 0;
            }
    }
}
