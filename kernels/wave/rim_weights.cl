/* Weights of samples across the rim of an aperture: a step without aliased frequencies.
 *
 * rim: the filtered step from RIM samples outside to RIM samples inside, RIM_STEPS entries per sample,
 * see rim_weights of clplen/wave/elements/rims.py.
 */
#ifndef CLPLEN_RIM_WEIGHTS
#define CLPLEN_RIM_WEIGHTS

#include "common.cl"

#define RIM 12
#define RIM_STEPS 64

/* Weight of a sample `inside` samples from the rim, < 0 outside. */
inline real rim_weight(real inside, __global const real *restrict rim, int size)
{
    const real place = clamp((inside + RIM) * RIM_STEPS, (real)0, (real)(size - 1));
    const int i = min((int)place, size - 2);
    return rim[i] + (place - i) * (rim[i + 1] - rim[i]);
}

#endif
