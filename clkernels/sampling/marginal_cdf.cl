// The CDF over the rows of an environment map, and the total weight of the map.
//
//     g(y) = sin(theta_y) row_sum(y)     total = sum over y of g(y)
//     cdf(y) = prefix sum over y of g(y) as integers (prefix_sum.clh)
//
// row_sum    height double words
// sin_theta  height floats
// cdf        height integers
// total      one double word
//
// A single work-item: a few thousand rows take a few microseconds.

#include "common/prefix_sum.clh"

kernel void marginal_cdf(global const float2 *restrict row_sum,
                         global const float *restrict sin_theta,
                         const uint height,
                         global uint *restrict cdf,
                         global float2 *restrict total)
{
    float2 sum = (float2)(0.0f);
    for (uint y = 0; y < height; ++y) {
        const float2 r = row_sum[y];
        const float s = sin_theta[y];
        const float hi = r.x * s;
        const float lo = fma(r.x, s, -hi) + r.y * s;
        sum = double_word_sum(sum, (float2)(hi, lo));
        cdf[y] = as_uint(hi);
    }
    *total = sum;
    weights_to_cdf(cdf, height, sum.x);
}
