// Prefix sums of w L^T along the rows of an environment map, as arc_sums.cl makes them, for a GPU.
//
// A work-item sums one number over a part of the row, then adds the parts before it. Another order of summation changes
// the last digits of double words.
//
// arcs  band x (VECTORS high and VECTORS low words) x (half + width + 1) x 4 floats: a vector of R, G, B and nothing for
//       each of w_x, w_y, w_z. With GREY a single vector: w_x, w_y, w_z times the one channel, and nothing
//
// Other arguments: arc_sums.cl. One group of GROUP work-items per row.

#define WIDTH 1

#include "common/double_word.clh"
#include "common/channels.clh"
#include "lighting/arc.clh"

#define NUMBERS (3 * CHANNELS)
#define PARTS (GROUP / NUMBERS)
#define AT_ONCE 8  // columns that are read before they are summed

// One number of w L^T at the stored columns from .. from + AT_ONCE - 1, 0 from `end` on; `radiance` is the channel's.
static inline void load_terms(global const float *radiance, global const float2 *phi, float2 t, float weight, uint width,
                              uint axis, uint from, uint end, private float *m)
{
#pragma unroll
    for (uint k = 0; k < AT_ONCE; ++k) {
        uint x = min(from + k, end - 1) + width / 2;  // stored rows begin at column -half_width
        x -= x < width ? 0 : x < 2 * width ? width : 2 * width;
        const float2 p = phi[x];
        const float w = axis == 0 ? t.x * p.y : axis == 1 ? t.y : t.x * p.x;
        m[k] = from + k < end ? radiance[3 * x] * weight * w : 0.0f;
    }
}

__attribute__((reqd_work_group_size(GROUP, 1, 1)))
kernel void arc_sums_grouped(global const float *restrict radiance,
                             global const float2 *restrict theta,
                             global const float2 *restrict phi,
                             global const float *restrict row_weight,
                             const uint width,
                             const uint first,
                             global float *restrict arcs)
{
    local float2 sums[GROUP];
    const uint i = get_local_id(0), number = i % NUMBERS, part = i / NUMBERS;
    const uint axis = number / CHANNELS, channel = number % CHANNELS;
    const uint row = get_global_id(0) / GROUP, y = first + row, half_width = (width + 1) / 2;
    const uint stride = half_width + width + 1, columns = (stride + PARTS - 1) / PARTS;
    const uint begin = min(part * columns, stride), end = part < PARTS ? min(begin + columns, stride) : begin;
    const float2 t = theta[y];
    const float weight = row_weight[y];
    radiance += (size_t)y * width * 3 + channel;
    arcs += (row * STORED + (VECTORS == 1 ? 0 : axis)) * (size_t)stride * 4 + (VECTORS == 1 ? axis : channel);

    float hi = 0.0f, lo = 0.0f, m[AT_ONCE];
    for (uint from = begin; from < end; from += AT_ONCE) {
        load_terms(radiance, phi, t, weight, width, axis, from, end, m);
#pragma unroll
        for (uint k = 0; k < AT_ONCE; ++k)
            DOUBLE_WORD_ADD(float, hi, lo, m[k]);
    }
    sums[i] = (float2)(hi, lo);
    barrier(CLK_LOCAL_MEM_FENCE);
    hi = lo = 0.0f;
    for (uint before = number; before < i; before += NUMBERS)
        DOUBLE_WORD_SUM(float, hi, lo, sums[before].x, sums[before].y);
    for (uint from = begin; from < end; from += AT_ONCE) {
        load_terms(radiance, phi, t, weight, width, axis, from, end, m);
#pragma unroll
        for (uint k = 0; k < AT_ONCE; ++k) {
            if (from + k < end) {
                arcs[(size_t)(from + k) * 4] = hi;
                arcs[(size_t)(from + k) * 4 + (size_t)VECTORS * stride * 4] = lo;
            }
            DOUBLE_WORD_ADD(float, hi, lo, m[k]);
        }
    }
}
