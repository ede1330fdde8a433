/* Weights W of the samples in pictures refocused by shear.cl, from its table `norm`.
 *
 * Included only.
 */
#ifndef CLPLEN_SHEAR_NORM
#define CLPLEN_SHEAR_NORM

#define HELD 16

/* Column in a row of norm of a vector of up to HELD samples from s on. */
static int norm_column(const int s, const int near, const int far)
{
    return s <= near ? s : s < far ? near : s - far + near + HELD;
}

/* Share of a row of views that lies inside for the picture's row y: 1, a part, or 0. */
static float row_weight(const int y, const int down, const float blend, const int ny)
{
    const bool above = y + down >= 0 && y + down < ny;
    const bool below = y + down + 1 >= 0 && y + down + 1 < ny;
    return above && below ? 1.0f : above ? 1.0f - blend : below ? blend : 0.0f;
}

/* True if all rows of views lie inside for the picture's row y. */
static bool all_inside(const int y, __global const int *down, __global const float *blend,
                       const int V, const int planes, const int ny)
{
    bool inside = true;
    for (int v = 0; v < V; ++v)
        inside = inside && row_weight(y, down[v * planes], blend[v * planes], ny) == 1.0f;
    return inside;
}

#endif
