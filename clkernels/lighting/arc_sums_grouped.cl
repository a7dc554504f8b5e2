// Prefix sums of w L^T along the rows of an environment map, as arc_sums.cl makes them, for a GPU.
//
// A work-item sums one number of a word over a part of the row, then adds the parts before it. So work-items side by
// side write a word, and a row is many work-items. Another order of summation changes the last digits of double words.
//
// Arguments: arc_sums.cl. One group of GROUP work-items per row.

#include "common/double_word.clh"
#include "common/channels.clh"

#ifdef GREY
#define WORD 4
#else
#define WORD 16
#endif
#define PARTS (GROUP / WORD)

// Number `part_of_word` of w L^T at column x.
static inline float term(global const float *radiance, global const float2 *phi, float2 t, float weight, uint x,
                         uint axis, uint channel)
{
    const float2 p = phi[x];
    const float w = axis == 0 ? t.x * p.y : axis == 1 ? t.y : t.x * p.x;
    return axis < 3 && channel < CHANNELS ? radiance[3 * x + channel] * weight * w : 0.0f;
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
    const uint i = get_local_id(0), number = i % WORD, part = i / WORD;
    const uint axis = number / (WORD / 4), channel = number % (WORD / 4);
    const uint row = get_global_id(0) / GROUP, y = first + row, half_width = (width + 1) / 2;
    const uint stride = half_width + width + 1, columns = (stride + PARTS - 1) / PARTS;
    const uint begin = min(part * columns, stride), end = min(begin + columns, stride);
    const float2 t = theta[y];
    const float weight = row_weight[y];
    radiance += (size_t)y * width * 3;
    arcs += (size_t)row * stride * 2 * WORD + number;

    float hi = 0.0f, lo = 0.0f;
    for (uint k = begin; k < end; ++k) {
        const uint x = k < half_width ? k + width - half_width : k == stride - 1 ? 0 : k - half_width;
        const float m = term(radiance, phi, t, weight, x, axis, channel);
        DOUBLE_WORD_ADD(float, hi, lo, m);
    }
    sums[i] = (float2)(hi, lo);
    barrier(CLK_LOCAL_MEM_FENCE);
    hi = lo = 0.0f;
    for (uint before = number; before < i; before += WORD)
        DOUBLE_WORD_SUM(float, hi, lo, sums[before].x, sums[before].y);
    for (uint k = begin; k < end; ++k) {
        arcs[(size_t)k * 2 * WORD] = hi;
        arcs[(size_t)k * 2 * WORD + WORD] = lo;
        const uint x = k < half_width ? k + width - half_width : k == stride - 1 ? 0 : k - half_width;
        const float m = term(radiance, phi, t, weight, x, axis, channel);
        DOUBLE_WORD_ADD(float, hi, lo, m);
    }
}
