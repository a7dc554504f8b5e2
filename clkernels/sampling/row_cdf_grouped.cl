// Row sums and row CDFs of an environment map on a GPU, bit for bit those of row_cdf.cl.
//
//     f(x, y) = max(0, scale (R + G + B) - offset)        row_sum(y) = sum over x of f(x, y)
//     cdf(x, y) = prefix sum over x of f(x, y) as integers (prefix_sum.clh)
//
// row_cdf.cl sums a row in 16 lanes, each of which adds every 16th pixel. For the same rounding, 16 work-items take the
// part of one lane each, and sum a tile of the row from local memory while the next one is being read. The CDFs are
// integers, which may be added in any order.
//
// Arguments: row_cdf.cl. One group of GROUP work-items per row.

#include "sampling/row_weights.clh"
#include "common/group_scan.clh"

#define EACH 16  // pixels per work-item in a tile
#define TILE (GROUP * EACH)
#define PLACE(x) ((x) + (x) / EACH)  // padded, so that neighbouring work-items use different banks of local memory

__attribute__((reqd_work_group_size(GROUP, 1, 1)))
kernel void row_cdf_grouped(global const float *restrict radiance,
                            const uint width,
                            const float scale,
                            const float offset,
                            global uint *restrict cdf,
                            global float2 *restrict row_sum)
{
    local uint tile[PLACE(TILE)], sums[GROUP];
    local float lanes[2 * LANES];
    const uint i = get_local_id(0);
    const size_t y = get_global_id(0) / GROUP;
    radiance += y * width * 3;
    cdf += y * width;

    float f[EACH], hi = 0.0f, lo = 0.0f;
#pragma unroll
    for (uint k = 0; k < EACH; ++k) {
        const uint x = k * GROUP + i;
        f[k] = x < width ? weight_above(radiance + 3 * (size_t)x, scale, offset) : 0.0f;
    }
    for (uint first = 0; first < width; first += TILE) {
#pragma unroll
        for (uint k = 0; k < EACH; ++k) {
            const uint x = k * GROUP + i;
            tile[PLACE(x)] = as_uint(f[k]);
            if (TILE < width && first + x < width)
                cdf[first + x] = as_uint(f[k]);
        }
        barrier(CLK_LOCAL_MEM_FENCE);
#pragma unroll
        for (uint k = 0; k < EACH; ++k) {
            const uint x = first + TILE + k * GROUP + i;
            f[k] = x < width ? weight_above(radiance + 3 * (size_t)x, scale, offset) : 0.0f;
        }
        if (i < LANES) {
            const uint end = min((uint)TILE, width - first);
#pragma unroll 8
            for (uint x = i; x < end; x += LANES)
                COMPENSATED_ADD(float, hi, lo, as_float(tile[PLACE(x)]));
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
    if (i < LANES) {
        lanes[i] = hi;
        lanes[LANES + i] = lo;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    if (i == 0) {
        const float2 sum = sum_of_double_words(vload16(0, lanes), vload16(1, lanes));
        row_sum[y] = sum;
        lanes[0] = sum.x;
    }
    barrier(CLK_LOCAL_MEM_FENCE);

    const float2 to_integers = quantisation(lanes[0]);
    uint carry = 0;
    for (uint first = 0; first < width; first += TILE) {
#pragma unroll
        for (uint k = 0; k < EACH; ++k) {
            const uint x = k * GROUP + i;
            const uint bits = TILE < width ? (first + x < width ? cdf[first + x] : 0) : tile[PLACE(x)];
            tile[PLACE(x)] = quantise_one(as_float(bits), to_integers);
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        uint entry[EACH], sum = 0, all;
#pragma unroll
        for (uint k = 0; k < EACH; ++k)
            entry[k] = sum += tile[PLACE(i * EACH + k)];
        const uint before = carry + sum_before(sum, sums, &all);
#pragma unroll
        for (uint k = 0; k < EACH; ++k)
            tile[PLACE(i * EACH + k)] = before + entry[k];
        barrier(CLK_LOCAL_MEM_FENCE);
#pragma unroll
        for (uint k = 0; k < EACH; ++k) {
            const uint x = k * GROUP + i;
            if (first + x < width)
                cdf[first + x] = tile[PLACE(x)];
        }
        carry += all;
    }
}
