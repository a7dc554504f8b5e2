// Row sums and row CDFs of an environment map on a GPU, bit for bit those of row_cdf.cl.
//
//     f(x, y) = max(0, scale (R + G + B) - offset)        row_sum(y, s) = sum over x in strip s of f(x, y)
//     cdf(x, y) = prefix sum over x, from the strip's first column on, of f(x, y) as integers (prefix_sum.clh)
//
// row_cdf.cl sums a row's part of a strip in 16 lanes, each of which adds every 16th pixel. For the same rounding, 16
// work-items per strip take the part of one lane each, and sum a tile of the row from local memory while the next one is
// being read. The CDFs are integers, which may be added in any order, and modulo 2^32: the prefix sums run through the
// whole row, and from each is subtracted the one before its strip.
//
// Arguments: row_cdf.cl. One group of GROUP work-items per row.

#include "common/strips.clh"
#include "sampling/row_weights.clh"
#include "common/group_scan.clh"

#define EACH 16  // pixels per work-item in a tile
#define TILE (GROUP * EACH)
#define PLACE(x) ((x) + (x) / EACH)  // padded, so that neighbouring work-items use different banks of local memory

#if GROUP < LANES * MOST_STRIPS
#error a group needs a work-item for every lane of every strip
#endif

// The strip of column x, which is not left of `strip`; beyond the last column, the last strip.
static inline uint strip_of(uint x, uint strip, uint bits, uint width)
{
    while ((strip + 1) >> bits == 0 && x >= strip_begin(strip + 1, bits, width))
        ++strip;
    return strip;
}

__attribute__((reqd_work_group_size(GROUP, 1, 1)))
kernel void row_cdf_grouped(global const float *restrict radiance,
                            const uint width,
                            const uint height,
                            const float scale,
                            const float offset,
                            const uint strip_bits,
                            global uint *restrict cdf,
                            global float2 *restrict row_sum)
{
    local uint tile[PLACE(TILE)], sums[GROUP], before_strip[MOST_STRIPS];
    local float lanes[2 * LANES * MOST_STRIPS];
    local float2 to_integers[MOST_STRIPS];
    const uint i = get_local_id(0);
    const size_t y = get_global_id(0) / GROUP;
    radiance += y * width * 3;
    cdf += y * width;
    const uint strip = i / LANES, strips = 1u << strip_bits;
    const uint strip_first = strip_begin(strip, strip_bits, width), strip_end = strip_begin(strip + 1, strip_bits, width);

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
        if (strip < strips) {
            const uint begin = max(first, strip_first) + i % LANES, end = min(first + TILE, strip_end);
#pragma unroll 8
            for (uint x = begin; x < end; x += LANES)
                COMPENSATED_ADD(float, hi, lo, as_float(tile[PLACE(x - first)]));
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
    if (strip < strips) {
        lanes[2 * LANES * strip + i % LANES] = hi;
        lanes[2 * LANES * strip + LANES + i % LANES] = lo;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    if (i < strips) {
        const float2 sum = sum_of_lanes_in_order(vload16(2 * i, lanes), vload16(2 * i + 1, lanes));
        row_sum[i * (size_t)height + y] = sum;
        to_integers[i] = quantisation(sum.x);
    }
    barrier(CLK_LOCAL_MEM_FENCE);

    uint carry = 0, of_pixel = 0, of_entry = 0;  // strips of the pixels that are rounded and of those that are written
    for (uint first = 0; first < width; first += TILE) {
#pragma unroll
        for (uint k = 0; k < EACH; ++k) {
            const uint x = k * GROUP + i;
            const uint bits = TILE < width ? (first + x < width ? cdf[first + x] : 0) : tile[PLACE(x)];
            of_pixel = strip_of(first + x, of_pixel, strip_bits, width);
            tile[PLACE(x)] = quantise_one(as_float(bits), to_integers[of_pixel]);
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
        if (i < strips) {
            const uint begin = strip_begin(i, strip_bits, width);
            if (first <= begin && begin < first + TILE)
                before_strip[i] = begin == first ? carry : tile[PLACE(begin - first - 1)];
        }
        barrier(CLK_LOCAL_MEM_FENCE);
#pragma unroll
        for (uint k = 0; k < EACH; ++k) {
            const uint x = k * GROUP + i;
            of_entry = strip_of(first + x, of_entry, strip_bits, width);
            if (first + x < width)
                cdf[first + x] = tile[PLACE(x)] - before_strip[of_entry];
        }
        carry += all;
    }
}
