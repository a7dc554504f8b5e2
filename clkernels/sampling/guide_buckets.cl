// Guide tables on a GPU, bit for bit those of guide.cl.
//
//     guide(b) bounds i(u) for all u of the bucket,    i(u) = the first i with cdf(i) > floor(u total / 2^32)
//
// guide.cl walks along the CDF; this kernel searches it, so that each bucket can have its own work-item.
//
// Arguments: guide.cl. One work-item per (bucket, CDF).

#include "common/guided.clh"
#include "common/strips.clh"

// The index of the first entry above u, out of the steps + 1 entries from cdf[first] on; the last of them is above u.
static inline uint first_above(global const uint *cdf, uint first, uint steps, uint u)
{
    while (steps > 0) {
        const uint half_steps = steps / 2;
        const bool is_above = cdf[first + half_steps] > u;
        first += is_above ? 0 : half_steps + 1;
        steps = is_above ? half_steps : steps - half_steps - 1;
    }
    return first;
}

kernel void guide_buckets(global const uint *restrict cdf,
                          const uint width,
                          const uint strip_bits,
                          const uint shift,
                          global uint2 *restrict guide,
                          global uint *restrict total)
{
    const uint b = get_global_id(0);
    const size_t index = get_global_id(1);
    const uint strip = index & ((1u << strip_bits) - 1), n = strip_width(strip, strip_bits, width);
    cdf += (index >> strip_bits) * width + strip_begin(strip, strip_bits, width);
    guide += index << (32 - shift);
    const uint sum = cdf[n - 1];
    if (b == 0)
        total[index] = sum;
    if (sum == 0)
        return;
    const ulong begin = (ulong)(b << shift) * sum, next = begin + ((ulong)sum << shift);
    const uint least = begin >> 32, most = (next - sum) >> 32;  // targets of the bucket's first and last u
    const uint first = first_above(cdf, 0, n - 1, least);
    if (cdf[first] > most)
        guide[b] = (uint2)(UINT_MAX, first);
    else if (cdf[first + 1] > most)
        guide[b] = (uint2)((uint)((((ulong)cdf[first] << 32) - 1) / sum), first);
    else
        guide[b] = (uint2)(first_above(cdf, first + 2, n - first - 3, most), first | SEVERAL_STEPS);
}
