/* Planes to compute: the first and the last one for 16 pixels of a row.
 *
 *   spans[y, x / 16] = (first, last), last < first for none; x / 16 < ceil(nx / 16)
 *
 * Included only.
 */
#ifndef CLPLEN_SPANS
#define CLPLEN_SPANS

inline int2 span_of(__global const int2 *spans, const int y, const int x, const int nx)
{
    return spans[(size_t)y * ((nx + 15) / 16) + x / 16];
}

inline int in_span(__global const int2 *spans, const int y, const int x, const int p, const int nx)
{
    const int2 span = span_of(spans, y, x, nx);
    return p >= span.x && p <= span.y;
}

#endif
