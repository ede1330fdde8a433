/* The adjoint of shear.cl: pictures of planes are spread back to the views.
 *
 *   S[p, y, s]    = picture[p, y, s] / W[p, y, s], 0 where W is 0 and outside
 *   L[v, u, y, s] = w[v, u] sum_p S[p](y - shift_y[p, v], s - channels shift_x[p, v, u])
 *
 * with s, W and the linear interpolation of shear.cl. A shift is an integer d and a fraction b. It
 * is separable, and rows interpolated along y serve all views of a row:
 *
 *   T_pv(y, s)    = (1 - b_v) S[p](y - d_v, s) + b_v S[p](y - d_v - 1, s)
 *   L[v, u, y, s] = sum_p w b_u T_pv(s - channels (d_u + 1)) + w (1 - b_u) T_pv(s - channels d_u)
 *
 * Tables (P planes of one launch, U views in a row, of which count[v] have a weight):
 *   order[v, k]      u of the k-th view with a weight
 *   span[v, p]       (first sample, number of further samples) of plane p used by the views
 *   slide[v, k, p]   samples from the first one to that of the k-th view
 *   taps[v, k, p]    (w b_u, w (1 - b_u))
 *   down[v, p], blend[v, p]   integer shift along y, and b_v
 *   norm             as in shear.cl
 *
 * divide            S of some planes. Mapping: FOR_X of common.cl over s, axis 1 = y, axis 2 = p;
 *                   with -DLANES an item = a row.
 * spread_blocks     one item = (width - channels) samples of a row of all views (v, u) of one v; for
 *                   CPUs. T_pv of all planes is stored in local memory and read for every view.
 * spread_samples    one item = a sample of HEIGHT rows of one view; for GPUs.
 *
 * `add`: the planes of this launch are added to those of earlier ones. Views without a weight are 0.
 *
 * -DLANES=4 | 8 | 16, -DVECTORS=n   spread_blocks, divide: vector type, vectors summed in registers
 * -DCHANNELS=1 | 3                  spread_blocks: number of channels, if 1 or 3
 * -DHEIGHT=n                        spread_samples
 * -DSAMPLE=float                    for stored.cl
 * -DROWS: see common.cl.
 */
#include "common.cl"
#include "stored.cl"
#include "shear_norm.cl"

#ifdef LANES
#include "shear_rows.cl"

static void store_global(__global float *to, const vec value)
{
    ((__global loose *)to)->v = value;
}

/* T_pv of some samples from `first` on, some of which may lie outside: a row of S and the row above,
 * with their weights. */
static void blend_rows(__local float *to, __global const float *row, __global const float *above,
                       const float of_row, const float of_above, const int first, const int n,
                       const int samples)
{
    const int begin = clamp(-first, 0, n);
    const int end = clamp(samples - first, begin, n);
    for (int i = 0; i < begin; ++i)
        to[i] = 0.0f;
    for (int i = end; i < n; ++i)
        to[i] = 0.0f;
    const int whole = end - (end - begin) % LANES;
    row += first;
    above += first;
    for (int i = begin; i < whole; i += LANES)
        store(to + i, load_global(row + i) * (vec)(of_row) + load_global(above + i) * (vec)(of_above));
    for (int i = whole; i < end; ++i)
        to[i] = row[i] * of_row + above[i] * of_above;
}

/* The first n samples of a chunk, to the light field or added to it. */
static void keep_chunk(__global float *to, const vec *a, const int n, const int add,
                       __local float *spare)
{
    for (int i = 0; i < VECTORS && i * LANES < n; ++i) {
        if (n - i * LANES >= LANES)
            store_global(to + i * LANES, add ? a[i] + load_global(to + i * LANES) : a[i]);
        else {
            store(spare, a[i]);
            for (int j = 0; j < n - i * LANES; ++j)
                to[i * LANES + j] = spare[j] + (add ? to[i * LANES + j] : 0.0f);
        }
    }
}

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void spread_blocks(__global float *restrict L, __global const float *restrict S,
                            __global const int *restrict count, __global const int *restrict order,
                            __global const int2 *restrict span, __global const int *restrict slide,
                            __global const float2 *restrict taps, __global const int *restrict down,
                            __global const float *restrict blend, const int U, const int ny,
                            const int samples, const int channels, const int planes,
                            const int plane0, const int add, const int width, const int pitch,
                            __local float *rows, __local float *second)
{
    const int s0 = get_global_id(0) * (width - channels);
    const int y = get_global_id(1);
    const int v = get_global_id(2);
    const int n = min(width - channels, samples - s0);
    for (int i = 0; i < max(channels, LANES); ++i)
        second[width + i] = 0.0f;  /* right of the block: summed, but not part of the view */

    for (int p = 0; p < planes && count[v] > 0; ++p) {
        const int at = v * planes + p, row = y - down[at];
        __global const float *plane = S + row_start(plane0 + p, 0, ny, samples);
        blend_rows(rows + p * pitch, plane + (size_t)clamp(row, 0, ny - 1) * samples,
                   plane + (size_t)clamp(row - 1, 0, ny - 1) * samples,
                   row >= 0 && row < ny ? 1.0f - blend[at] : 0.0f,
                   row >= 1 && row <= ny ? blend[at] : 0.0f, s0 + span[at].x, width + span[at].y,
                   samples);
    }
    for (int k = 0; k < U; ++k) {
        __global float *to = L + row_start(v * U + order[v * U + k], y, ny, samples) + s0;
        if (k < count[v]) {
            const int table = (v * U + k) * planes;
            for (int i = width - CHUNK; i >= 0; i -= CHUNK) {
                vec a[VECTORS];
                chunk_of(a, rows + i, second + i, planes, pitch, channels, slide + table,
                         taps + table);
                keep_chunk(to + i, a, n - i, add, second + width + max(channels, LANES));
            }
        } else if (!add)
            for (int i = 0; i < n; ++i)
                to[i] = 0.0f;
    }
}
#endif

#ifdef HEIGHT
/* Sample s of row y of a plane, 0 outside. */
static float inside(__global const float *row, const int s, const int samples)
{
    return s >= 0 && s < samples ? row[s] : 0.0f;
}

__kernel void spread_samples(__global float *restrict L, __global const float *restrict S,
                             __global const int *restrict count, __global const int *restrict order,
                             __global const int2 *restrict span, __global const int *restrict slide,
                             __global const float2 *restrict taps, __global const int *restrict down,
                             __global const float *restrict blend, const int U, const int ny,
                             const int samples, const int channels, const int planes,
                             const int plane0, const int add)
{
    const int s = get_global_id(0);
    const int y0 = get_global_id(1) * HEIGHT;
    const int view = get_global_id(2), v = view / U, k = view % U;
    if (s >= samples || (add && k >= count[v]))
        return;
    float sums[HEIGHT];
    for (int r = 0; r < HEIGHT; ++r)
        sums[r] = 0.0f;
    for (int p = 0; p < planes && k < count[v]; ++p) {
        const int at = v * planes + p, top = y0 - down[at] - 1;
        const int from = s + span[at].x + slide[view * planes + p];
        const float2 w = taps[view * planes + p];
        const float b = blend[at];
        __global const float *plane = S + row_start(plane0 + p, 0, ny, samples);
        float upper = 0.0f;
        for (int r = 0; r <= HEIGHT; ++r) {
            const int row = top + r;
            float lower = 0.0f;
            if (row >= 0 && row < ny) {
                __global const float *line = plane + (size_t)row * samples;
                lower = w.x * inside(line, from, samples)
                        + w.y * inside(line, from + channels, samples);
            }
            if (r > 0)
                sums[r - 1] += (1.0f - b) * lower + b * upper;
            upper = lower;
        }
    }
    for (int r = 0; r < min(HEIGHT, ny - y0); ++r) {
        __global float *to = L + row_start(v * U + order[view], y0 + r, ny, samples) + s;
        *to = add ? *to + sums[r] : sums[r];
    }
}
#endif

__kernel void divide(__global float *restrict S, __global const float *restrict picture,
                     __global const float *restrict norm, __global const int *restrict down,
                     __global const float *restrict blend, const int V, const int ny,
                     const int samples, const int planes, const int plane0, const int norm_pitch,
                     const int near, const int far)
{
    const int y = get_global_id(1), p = get_global_id(2);
    const size_t at = row_start(plane0 + p, y, ny, samples);
    __global const float *table = norm + (size_t)p * (V + 1) * norm_pitch;
    const bool whole = all_inside(y, down + p, blend + p, V, planes, ny);
    int s = 0;
#ifdef LANES
    for (; s + LANES <= samples; s += LANES) {
        __global const float *here = table + norm_column(s, near, far);
        vec used = (vec)(0.0f);
        if (whole)
            used = load_global(here + V * norm_pitch);
        else
            for (int v = 0; v < V; ++v)
                used += load_global(here + v * norm_pitch)
                        * (vec)(row_weight(y, down[v * planes + p], blend[v * planes + p], ny));
        const vec mean = load_global(picture + at + s) / used;
        store_global(S + at + s, used != (vec)(0.0f) ? mean : (vec)(0.0f));
    }
#endif
    FROM_X(s, samples) {
        __global const float *here = table + norm_column(s, near, far);
        float used = 0.0f;
        if (whole)
            used = here[V * norm_pitch];
        else
            for (int v = 0; v < V; ++v)
                used += here[v * norm_pitch]
                        * row_weight(y, down[v * planes + p], blend[v * planes + p], ny);
        S[at + s] = used != 0.0f ? picture[at + s] / used : 0.0f;
    }
}
