// Row sums and row CDFs of an environment map.
//
//     f(x, y) = max(0, scale (R + G + B) - offset)        row_sum(y) = sum over x of f(x, y)
//     cdf(x, y) = prefix sum over x of f(x, y) as integers (prefix_sum.clh)
//
// sin(theta) is the same for a whole row, so p(x | y) = f(x, y) / row_sum(y) does not need it.
//
// radiance  height x width x 3 floats, finite and >= 0
// scale     a power of two that keeps the sum over the map inside float's range
// offset    for MIS compensation, the part of the weights that is left to another sampler; otherwise 0
//           With PLAIN, scale is 1 and offset 0, and neither is read.
// cdf       height x width integers
// row_sum   height double words
//
// One work-item per row, in two passes: the first reads the map, sums the weights and leaves them in `cdf`; the second
// turns them into prefix sums while they are still in the cache.

#include "sampling/row_weights.clh"

kernel void row_cdf(global const float *restrict radiance,
                    const uint width,
                    const float scale,
                    const float offset,
                    global uint *restrict cdf,
                    global float2 *restrict row_sum)
{
    const size_t y = get_global_id(0);
    radiance += y * width * 3;
    cdf += y * width;

    float16 hi = 0.0f, lo = 0.0f;
    const uint whole = width - width % LANES;
    for (uint x = 0; x < whole; x += LANES) {
        const float16 f = weights_above(radiance + 3 * (size_t)x, scale, offset);
        store_unaligned(as_uint16(f), cdf + x);
        COMPENSATED_ADD(float16, hi, lo, f);
    }
    if (whole < width) {
        float rest[LANES] = {0.0f};
        for (uint x = whole; x < width; ++x) {
            const float f = weight_above(radiance + 3 * (size_t)x, scale, offset);
            cdf[x] = as_uint(f);
            rest[x - whole] = f;
        }
        const float16 f = vload16(0, rest);
        COMPENSATED_ADD(float16, hi, lo, f);
    }

    const float2 sum = sum_of_double_words(hi, lo);
    row_sum[y] = sum;
    weights_to_cdf_prefetching(cdf, width, sum.x, radiance + 3 * (size_t)width);
}
