// Prefix sums of w L^T along the rows of an environment map, so that the light from an arc of a row is one difference.
//
//     arc(k) = sum over columns x < k of w (R, G, B) row_weight(y)      k = -half .. width,  half = (width + 1) / 2
//
// Columns below 0 repeat those at the end of the row, so an arc of at most one turn about any 0 <= phi <= pi needs no
// wrapping. Sums are double words, so that a sun in the row costs other arcs no precision.
//
// radiance    height x width x 3 floats, finite and >= 0
// theta, phi  (sin, cos) of every row and of every column
// row_weight  by row: a pixel's solid angle / pi, times a power of two that keeps the sums inside float's range
// first       the first row of this band
// arcs        band x (half + width + 1) x 2 x 16 floats: high and low words of w_x L, w_y L, w_z L (4 floats each, the
//             last 0) and 4 zeros: one cache line per word. With GREY the channels are equal, and a word has 4 floats:
//             w_x, w_y, w_z times the one channel, and 0
//
// One work-item per row.

#include "common/double_word.clh"
#include "lighting/arc.clh"

kernel void arc_sums(global const float *restrict radiance,
                     global const float2 *restrict theta,
                     global const float2 *restrict phi,
                     global const float *restrict row_weight,
                     const uint width,
                     const uint first,
                     global arc *restrict arcs)
{
    const uint row = get_global_id(0), y = first + row, half_width = (width + 1) / 2;
    const size_t stride = half_width + width + 1;
    const float2 t = theta[y];
    const float weight = row_weight[y];
    radiance += (size_t)y * width * 3;
    arcs += row * stride * 2;

    arc hi = 0.0f, lo = 0.0f;
    uint x = width - half_width;
    for (size_t k = 0; k < stride; ++k) {
        arcs[2 * k] = hi;
        arcs[2 * k + 1] = lo;
        const float2 p = phi[x];
#ifdef GREY
        const arc m = radiance[3 * x] * weight * (float4)(t.x * p.y, t.y, t.x * p.x, 0.0f);
#else
        const float4 L = (float4)(vload3(x, radiance) * weight, 0.0f);
        const arc m = (arc)(L * (t.x * p.y), L * t.y, L * (t.x * p.x), (float4)(0.0f));
#endif
        DOUBLE_WORD_ADD(arc, hi, lo, m);
        x = x + 1 < width ? x + 1 : 0;
    }
}
