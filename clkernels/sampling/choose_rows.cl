// The rows that samples of an environment map fall into, and the numbers that pick the pixels in them.
//
//     row(i) = the row that `down` picks by the CDF over rows of the strip that `across` picks (strips.clh)
//     across(i) = `across`    for point i = (across, down)
//
// marginal_cdf  from marginal_cdf.cl, strips x height integers
// strips, strip_bits
//               the table of the map's 2^strip_bits strips
// seed, generator
//               of the sequence that the points come from (sequence.clh)
// row           count integers
// across        count integers, fractions of 2^64
// place         count integers: where in the row's step of the CDF `down` lies, a fraction of 2^32 (within_pixel.clh)
//
// One work-item per sample; those beyond `count`, which fill up the last group, do nothing. When the whole map is on
// the device, sample.cl picks the rows itself.

#include "common/sequence.clh"
#include "common/within_pixel.clh"

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
                        global const uint4 *restrict strips,
                        const uint strip_bits,
                        const uint height,
                        const uint count,
                        const uint2 seed,
                        const uint generator,
                        global uint *restrict row,
                        global ulong *restrict across,
                        global uint *restrict place)
{
    const uint i = get_global_id(0);
    if (i >= count)
        return;
    const uint2 point = sequence_point(i, count, generator, 0u, seed);
    const uint2 further = further_bits(i, 0u, seed);
    marginal_cdf += (size_t)strips[strip_entry(strips, strip_bits, point.x)].w * height;
    const uint y = invert_cdf(marginal_cdf, height, point.y);
    row[i] = y;
    across[i] = ((ulong)point.x << 32) + further.x;
    const uint below = y == 0 ? 0 : marginal_cdf[y - 1], total = marginal_cdf[height - 1];
    place[i] = place_between(point.y, further.y, points_below(below, total), points_below(marginal_cdf[y], total));
}
