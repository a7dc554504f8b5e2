// Row sums and row CDFs of an environment map.
//
//     f(x, y) = max(0, scale (R + G + B) - offset)        row_sum(y) = sum over x of f(x, y)
//     cdf(x, y) = prefix sum over x of f(x, y) as integers (prefix_sum.clh)
//
// sin(theta) is the same for a whole row, so p(x | y) = f(x, y) / row_sum(y) does not need it.
//
// radiance  height x width x 3 floats, finite and >= 0
// scale     a power of two that keeps the sum over the map inside float's range
// offset    for MIS compensation: the part of f that is left to another sampler, else 0
//           With PLAIN, scale is 1 and offset 0, and neither is read.
// cdf       height x width integers
// row_sum   height double words
//
// One work-item per row: the first pass reads the map once, sums the weights and leaves them in `cdf`, the second turns
// them into prefix sums while they are still in the cache.

#include "common/prefix_sum.clh"

// f of 16 pixels, and of one.
static inline float16 weights_above(global const float *rgb, float scale, float offset)
{
#ifdef PLAIN
    return weights(rgb, 1.0f);
#else
    return fmax(weights(rgb, scale) - offset, 0.0f);
#endif
}

static inline float weight_above(global const float *rgb, float scale, float offset)
{
#ifdef PLAIN
    return weight(rgb, 1.0f);
#else
    return fmax(weight(rgb, scale) - offset, 0.0f);
#endif
}

// The sum of 16 double words, always by the same tree: lanes 8, 4, 2 and 1 apart are added, cyclically, so that in the
// end every lane holds it.
static inline float2 sum_of_double_words(float16 hi, float16 lo)
{
    DOUBLE_WORD_SUM(float16, hi, lo, BEFORE_8(float, hi, hi), BEFORE_8(float, lo, lo));
    DOUBLE_WORD_SUM(float16, hi, lo, BEFORE_4(float, hi, hi), BEFORE_4(float, lo, lo));
    DOUBLE_WORD_SUM(float16, hi, lo, BEFORE_2(float, hi, hi), BEFORE_2(float, lo, lo));
    DOUBLE_WORD_SUM(float16, hi, lo, BEFORE_1(float, hi, hi), BEFORE_1(float, lo, lo));
    return (float2)(hi.s0, lo.s0);
}

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
