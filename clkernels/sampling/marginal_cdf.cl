// The CDFs over the rows of an environment map, one for each strip of columns, and the total weight of each strip.
//
//     g(y, s) = sin(theta_y) row_sum(y, s)     total(s) = sum over y of g(y, s)
//     cdf(s, y) = prefix sum over y of g(y, s) as integers (prefix_sum.clh)
//
// row_sum    strips x height double words
// sin_theta  height floats
// cdf        strips x height integers
// total      strips double words
//
// One work-item per strip, 16 rows at a time: a few thousand rows take a few microseconds.

#include "common/prefix_sum.clh"

// Add the term s r of 16 rows to hi + lo, where r is the double word (r_hi, r_lo); returns the high word of the term.
static inline float16 add_rows(float16 r_hi, float16 r_lo, float16 s, private float16 *hi, private float16 *lo)
{
    const float16 g = r_hi * s;
    COMPENSATED_ADD(float16, *hi, *lo, g);
    *lo += fma(r_hi, s, -g) + r_lo * s;
    return g;
}

kernel void marginal_cdf(global const float2 *restrict row_sum,
                         global const float *restrict sin_theta,
                         const uint height,
                         global uint *restrict cdf,
                         global float2 *restrict total)
{
    const size_t strip = get_global_id(0);
    row_sum += strip * height;
    cdf += strip * height;

    float16 hi = 0.0f, lo = 0.0f;
    const uint whole = height - height % LANES;
    for (uint y = 0; y < whole; y += LANES) {
        global const float *r = (global const float *)(row_sum + y);
        const float16 a = vload16(0, r), b = vload16(1, r);
        const float16 r_hi = (float16)(a.even, b.even), r_lo = (float16)(a.odd, b.odd);
        store_unaligned(as_uint16(add_rows(r_hi, r_lo, vload16(0, sin_theta + y), &hi, &lo)), cdf + y);
    }
    if (whole < height) {
        float r_hi[LANES] = {0.0f}, r_lo[LANES] = {0.0f}, s[LANES] = {0.0f}, g[LANES];
        for (uint y = whole; y < height; ++y) {
            r_hi[y - whole] = row_sum[y].x;
            r_lo[y - whole] = row_sum[y].y;
            s[y - whole] = sin_theta[y];
        }
        vstore16(add_rows(vload16(0, r_hi), vload16(0, r_lo), vload16(0, s), &hi, &lo), 0, g);
        for (uint y = whole; y < height; ++y)
            cdf[y] = as_uint(g[y - whole]);
    }
    const float2 sum = sum_of_lanes_in_order(hi, lo);
    total[strip] = sum;
    weights_to_cdf(cdf, height, sum.x);
}
