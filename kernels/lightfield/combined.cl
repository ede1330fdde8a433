/* Kernels of the combined depth cue in one program, which builds faster than several.
 *
 *   match     cost of every plane at every pixel: matching.cl, match_rows.cl
 *   gather, valley    costs averaged over neighbours, and their minimum: support.cl, gather_rows.cl,
 *                     valley_rows.cl
 *   normal, fit       disparity refined by least squares: refine.cl, normal_rows.cl, fit_rows.cl
 *
 * -DSAMPLE=uchar | ushort | half | float, -DCHANNELS=n, -DRADIUS=n, -DBLOCK=n, -DMATCH_BLOCK=n; -DROWS
 * -DLANES=4 | 8 | 16, -DMATCH_VECTORS=n: also the vector kernels
 */
#include "common.cl"
#include "stored.cl"
#include "matching.cl"
#include "support.cl"
#include "refine.cl"
#ifdef LANES
#include "fit_rows.cl"
#include "gather_rows.cl"
#include "match_rows.cl"
#include "normal_rows.cl"
#include "valley_rows.cl"
#endif
