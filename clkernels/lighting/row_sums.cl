// Sums over the rows of an environment map from the left, in integers: the beginning of a summed-area table.
//
//     q(x, y) = round(f(x, y) sin(theta_y) 2^k), f = scale (R + G + B): the light of a pixel
//     table(x, y) = sum over i <= x, and j <= y in the band of y, of min(q(i, j), cap)
//     row(y)      = (sum of the q <= cap, number of q > cap, number of q > 0, largest q)
//
// A band is BAND rows, or what is left of the map. 2^k keeps the sum over the map below 2^63, so all sums and
// differences are exact, in any order, whatever the range of the map. column_sums.cl completes the table.
//
// radiance     height x width x 3 floats, finite and >= 0
// sin_theta    height floats
// scale        a power of two that keeps the sum over the map inside float's range
// quantum      two powers of two whose product is 2^k
// cap          the most that a pixel counts for: an equal share of the energy (median_cut.py); 1 counts lit pixels
// again        whether `table` and `row` hold the sums for a larger cap; bands with no pixel above the new one are then
//              left as they are
// table        height x width integers of 64 bits
// row          height x 4 integers of 64 bits
//
// One work-item per band, 16 pixels at a time.

#include "common/prefix_sum.clh"

// Stores 16 numbers at once; vstore16 would become several stores (prefix_sum.clh).
typedef ulong16 unaligned_ulong16 __attribute__((aligned(8)));

kernel void row_sums(global const float *restrict radiance,
                     global const float *restrict sin_theta,
                     const uint width,
                     const uint height,
                     const float scale,
                     const float2 quantum,
                     const ulong cap,
                     const uint again,
                     global ulong *restrict table,
                     global ulong *restrict row)
{
    const uint first = get_global_id(0) * BAND, end = min(first + BAND, height), whole = width - width % LANES;
    if (again) {
        ulong largest = 0;
        for (uint y = first; y < end; ++y)
            largest = max(largest, row[4 * (size_t)y + 3]);
        if (largest <= cap)
            return;
    }
    for (uint y = first; y < end; ++y) {
        global const float *of_row = radiance + 3 * (size_t)y * width;
        global ulong *sums = table + (size_t)y * width;
        const float sine = sin_theta[y];
        // Prefix sums by a sliding window, see weights_to_cdf_prefetching in prefix_sum.clh.
        ulong16 before1 = 0ul, before2 = 0ul, before4 = 0ul, before8 = 0ul, sum16 = 0ul, heavy16 = 0ul;
        int16 lit16 = 0;
        float16 largest16 = 0.0f;
        for (uint x = 0; x < whole; x += LANES) {
            const float16 light = weights(of_row + 3 * (size_t)x, scale) * sine * quantum.x * quantum.y + 0.5f;
            largest16 = fmax(largest16, light);
            lit16 -= light >= 1.0f;  // true is all bits set
            const ulong16 q = convert_ulong16(convert_long16(light));
            heavy16 -= as_ulong16(q > cap);
            const ulong16 last1 = min(q, (ulong16)(cap));
            const ulong16 last2 = last1 + BEFORE_1(ulong, before1, last1);
            const ulong16 last4 = last2 + BEFORE_2(ulong, before2, last2);
            const ulong16 last8 = last4 + BEFORE_4(ulong, before4, last4);
            sum16 += last8 + BEFORE_8(ulong, before8, last8);
            before1 = last1, before2 = last2, before4 = last4, before8 = last8;
            const ulong16 of_band = y > first ? sum16 + vload16(0, sums - width + x) : sum16;
            *(global unaligned_ulong16 *)(sums + x) = of_band;
        }

        const ulong8 heavy8 = heavy16.lo + heavy16.hi;
        const ulong4 heavy4 = heavy8.lo + heavy8.hi;
        const int8 lit8 = lit16.lo + lit16.hi;
        const int4 lit4 = lit8.lo + lit8.hi;
        const float8 largest8 = fmax(largest16.lo, largest16.hi);
        const float4 largest4 = fmax(largest8.lo, largest8.hi);
        ulong heavy = heavy4.x + heavy4.y + heavy4.z + heavy4.w, sum = sum16.sf;
        uint lit = lit4.x + lit4.y + lit4.z + lit4.w;
        float largest = fmax(fmax(largest4.x, largest4.y), fmax(largest4.z, largest4.w));
        for (uint x = whole; x < width; ++x) {
            const float light = weight(of_row + 3 * (size_t)x, scale) * sine * quantum.x * quantum.y + 0.5f;
            largest = fmax(largest, light);
            const ulong q = (ulong)(long)light;
            lit += q != 0;
            heavy += q > cap;
            sum += min(q, cap);
            sums[x] = y > first ? sum + *(sums + x - width) : sum;
        }
        vstore4((ulong4)(sum - heavy * cap, heavy, lit, (ulong)(long)largest), y, row);
    }
}
