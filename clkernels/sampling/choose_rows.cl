// The rows that samples of an environment map fall into, and what picks the pixels in them.
//
//     row(i) from the CDF over rows at the second half of point i, across(i) = the first half
//
// marginal_cdf  from marginal_cdf.cl, height integers
// row, across   count integers; across as a fraction of 2^32
//
// One work-item a sample, in whole groups. sample.cl does the same where the whole map is at hand.

#include "common/sequence.clh"

// The first i with cdf[i] > u total / 2^32 (prefix_sum.clh), by binary search.
static inline uint invert_cdf(global const uint *cdf, uint n, uint u)
{
    const uint target = mul_hi(u, cdf[n - 1]);
    uint first = 0;
    while (n > 0) {
        const uint half_n = n / 2;
        if (cdf[first + half_n] <= target) {
            first += half_n + 1;
            n -= half_n + 1;
        } else {
            n = half_n;
        }
    }
    return first;
}

kernel void choose_rows(global const uint *restrict marginal_cdf,
                        const uint height,
                        const uint count,
                        const uint2 seed,
                        global uint *restrict row,
                        global uint *restrict across)
{
    const uint i = get_global_id(0);
    if (i >= count)
        return;
    const uint2 point = sequence_point(i, count, 0u, seed);
    row[i] = invert_cdf(marginal_cdf, height, point.y);
    across[i] = point.x;
}
