// Guide tables: for every bucket b = u >> shift, where the searches of an integer CDF (prefix_sum.clh) end.
//
//     guide(b) bounds i(u) for all u of the bucket,    i(u) = the first i with cdf(i) > floor(u total / 2^32)
//
// Most buckets hold at most one step of the CDF, to the next entry, and then a search takes a single comparison.
// Source: Chen and Asau, On Generating Random Variates from an Empirical Distribution (1974); Devroye, Non-Uniform
// Random Variate Generation (1986), III.2.4; a record splits its bucket as the alias method does.
//
// cdf      rows of `width` integers, each of which holds the CDFs of 2^strip_bits strips (strips.clh)
// guide    2^32 >> shift records per CDF, see guided.clh; those of an empty CDF stay unset, as it is never searched
// total    the last entry of each CDF
//
// One work-item per CDF.

#include "common/guided.clh"
#include "common/strips.clh"

kernel void guide(global const uint *restrict cdf,
                  const uint width,
                  const uint strip_bits,
                  const uint shift,
                  global uint2 *restrict guide,
                  global uint *restrict total)
{
    const size_t index = get_global_id(0);
    const uint buckets = 1u << (32 - shift), strip = index & ((1u << strip_bits) - 1);
    cdf += (index >> strip_bits) * width + strip_begin(strip, strip_bits, width);
    guide += index * buckets;
    const uint sum = cdf[strip_width(strip, strip_bits, width) - 1];
    total[index] = sum;
    if (sum == 0)
        return;
    uint first = 0, end = 0;
    for (uint b = 0; b < buckets; ++b) {
        const ulong begin = (ulong)(b << shift) * sum, next = begin + ((ulong)sum << shift);
        const uint least = begin >> 32, most = (next - sum) >> 32;  // targets of the bucket's first and last u
        while (cdf[first] <= least)
            ++first;
        end = max(end, first);
        while (cdf[end] <= most)
            ++end;
        if (end == first)
            guide[b] = (uint2)(UINT_MAX, first);
        else if (end == first + 1)
            guide[b] = (uint2)((uint)((((ulong)cdf[first] << 32) - 1) / sum), first);
        else
            guide[b] = (uint2)(end, first | SEVERAL_STEPS);
    }
}
