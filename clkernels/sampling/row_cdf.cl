// Row sums and row CDFs of an environment map, for each strip of columns (strips.clh).
//
//     f(x, y) = max(0, scale (R + G + B) - offset)        row_sum(y, s) = sum over x in strip s of f(x, y)
//     cdf(x, y) = prefix sum over x, from the strip's first column on, of f(x, y) as integers (prefix_sum.clh)
//
// sin(theta) is the same for a whole row, so p(x | y, s) = f(x, y) / row_sum(y, s) does not need it.
//
// radiance  height x width x 3 floats, finite and >= 0
// scale     a power of two that keeps the sum over the map inside float's range
// offset    for MIS compensation, the part of the weights that is left to another sampler; otherwise 0
//           With PLAIN, scale is 1 and offset 0, and neither is read.
// strip_bits
//           there are 2^strip_bits strips
// cdf       height x width integers
// row_sum   strips x height double words
//
// One work-item per row, in two passes: the first reads the map, sums the weights and leaves them in `cdf`; the second
// turns them into prefix sums while they are still in the cache.

#include "common/strips.clh"
#include "sampling/row_weights.clh"

kernel void row_cdf(global const float *restrict radiance,
                    const uint width,
                    const uint height,
                    const float scale,
                    const float offset,
                    const uint strip_bits,
                    global uint *restrict cdf,
                    global float2 *restrict row_sum)
{
    const size_t y = get_global_id(0);
    radiance += y * width * 3;
    cdf += y * width;

    float16 hi[MOST_STRIPS], lo[MOST_STRIPS];
    for (uint strip = 0, begin = 0; strip < MOST_STRIPS; ++strip) {
        const uint end = strip_begin(strip + 1, strip_bits, width), whole = end - (end - begin) % LANES;
        float16 h = 0.0f, l = 0.0f;
        for (uint x = begin; x < whole; x += LANES) {
            const float16 f = weights_above(radiance + 3 * (size_t)x, scale, offset);
            store_unaligned(as_uint16(f), cdf + x);
            COMPENSATED_ADD(float16, h, l, f);
        }
        if (whole < end) {
            float rest[LANES] = {0.0f};
            for (uint x = whole; x < end; ++x) {
                const float f = weight_above(radiance + 3 * (size_t)x, scale, offset);
                cdf[x] = as_uint(f);
                rest[x - whole] = f;
            }
            const float16 f = vload16(0, rest);
            COMPENSATED_ADD(float16, h, l, f);
        }
        hi[strip] = h;
        lo[strip] = l;
        begin = end;
    }

    float sum_hi[MOST_STRIPS], sum_lo[MOST_STRIPS];
    sum_lanes(hi, lo, sum_hi, sum_lo);
    for (uint strip = 0, begin = 0; begin < width; ++strip) {
        const uint end = strip_begin(strip + 1, strip_bits, width);
        row_sum[(size_t)strip * height + y] = (float2)(sum_hi[strip], sum_lo[strip]);
        weights_to_cdf_prefetching(cdf + begin, end - begin, sum_hi[strip], radiance + 3 * (size_t)width + begin);
        begin = end;
    }
}
