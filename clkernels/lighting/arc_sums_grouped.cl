// Prefix sums of w L^T along the rows of an environment map on a GPU, those of arc_sums.cl up to rounding.
//
//     arc(k) = sum over columns x < k of w (R, G, B) row_weight(y)      k = -half .. width,  half = (width + 1) / 2
//
// A work-item sums one vector of 4 floats over a part of the row, then adds the sums of the parts before it. This order
// of summation changes the last digits of the double words.
//
// arcs  band x 2 (high, low) x VECTORS x (half + width + 1) vectors of 4 floats: (R, G, B, 0) times w_x, times w_y and
//       times w_z; with GREY one vector, (w_x, w_y, w_z, 0) times the one channel
//
// Other arguments: arc_sums.cl. One group of GROUP work-items per row.

#define WIDTH 1

#include "common/double_word.clh"
#include "lighting/arc.clh"

#define PARTS (GROUP / VECTORS)
#define AT_ONCE 8  // columns that are read before they are summed

// One vector of w L^T at each of the stored columns from .. from + AT_ONCE - 1; 0 from column `end` on.
static inline void load_terms(global const float *radiance, global const float2 *phi, float2 t, float weight,
                              uint width, uint axis, uint from, uint end, private float4 *m)
{
#pragma unroll
    for (uint k = 0; k < AT_ONCE; ++k) {
        uint x = min(from + k, end - 1) + width / 2;  // stored rows begin at column -half_width
        x -= x < width ? 0 : x < 2 * width ? width : 2 * width;
        const float2 p = phi[x];
#ifdef GREY
        m[k] = radiance[3 * x] * weight * (float4)(t.x * p.y, t.y, t.x * p.x, 0.0f);
#else
        m[k] = (float4)(vload3(x, radiance) * weight, 0.0f) * (axis == 0 ? t.x * p.y : axis == 1 ? t.y : t.x * p.x);
#endif
        m[k] = from + k < end ? m[k] : 0.0f;
    }
}

__attribute__((reqd_work_group_size(GROUP, 1, 1)))
kernel void arc_sums_grouped(global const float *restrict radiance,
                             global const float2 *restrict theta,
                             global const float2 *restrict phi,
                             global const float *restrict row_weight,
                             const uint width,
                             const uint first,
                             global float4 *restrict arcs)
{
    local float4 high[GROUP], low[GROUP];
    const uint i = get_local_id(0), axis = i % VECTORS, part = i / VECTORS;
    const uint row = get_global_id(0) / GROUP, y = first + row, half_width = (width + 1) / 2;
    const uint stride = half_width + width + 1, columns = (stride + PARTS - 1) / PARTS;
    const uint begin = min(part * columns, stride), end = part < PARTS ? min(begin + columns, stride) : begin;
    const float2 t = theta[y];
    const float weight = row_weight[y];
    radiance += (size_t)y * width * 3;
    arcs += (row * 2 * VECTORS + axis) * (size_t)stride;

    float4 hi = 0.0f, lo = 0.0f, m[AT_ONCE];
    for (uint from = begin; from < end; from += AT_ONCE) {
        load_terms(radiance, phi, t, weight, width, axis, from, end, m);
#pragma unroll
        for (uint k = 0; k < AT_ONCE; ++k)
            DOUBLE_WORD_ADD(float4, hi, lo, m[k]);
    }
    high[i] = hi;
    low[i] = lo;
    barrier(CLK_LOCAL_MEM_FENCE);
    hi = lo = 0.0f;
    for (uint before = axis; before < i; before += VECTORS)
        DOUBLE_WORD_SUM(float4, hi, lo, high[before], low[before]);
    for (uint from = begin; from < end; from += AT_ONCE) {
        load_terms(radiance, phi, t, weight, width, axis, from, end, m);
#pragma unroll
        for (uint k = 0; k < AT_ONCE; ++k) {
            if (from + k < end) {
                arcs[from + k] = hi;
                arcs[from + k + (size_t)VECTORS * stride] = lo;
            }
            DOUBLE_WORD_ADD(float4, hi, lo, m[k]);
        }
    }
}
