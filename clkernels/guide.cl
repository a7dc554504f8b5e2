// Guide tables: where in an integer CDF (prefix_sum.clh) the search for u begins and ends.
//
//     guide(b) = first i with cdf[i] > u total / 2^32, for the least u of bucket b = u >> shift
//
// The search for u in bucket b ends from guide(b) to guide(b + 1): most often these are the same, and nothing is left
// to search. Source: Chen and Asau, On Generating Random Variates from an Empirical Distribution (1974); Devroye,
// Non-Uniform Random Variate Generation (1986), III.2.4.
//
// cdf      n integers a CDF, one CDF after another
// guide    (2^32 >> shift) + 1 indices a CDF, the last one n - 1; an empty CDF is never searched
// total    the last entry of each CDF
//
// One work-item a CDF.

#include "guided.clh"

kernel void guide(global const uint *restrict cdf,
                  const uint n,
                  const uint shift,
                  global guide_index *restrict guide,
                  global uint *restrict total)
{
    const size_t row = get_global_id(0);
    const uint buckets = 1u << (32 - shift);
    cdf += row * n;
    guide += row * (buckets + 1);
    const uint end = cdf[n - 1];
    total[row] = end;
    uint i = 0;
    for (uint b = 0; b < buckets; ++b) {
        const uint target = mul_hi(b << shift, end);
        while (end > 0 && cdf[i] <= target)
            ++i;
        guide[b] = i;
    }
    guide[buckets] = n - 1;
}
