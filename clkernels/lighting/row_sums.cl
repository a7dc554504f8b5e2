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
// again        whether `table` and `row` are those of a larger cap; bands with no pixel above the new one then stay
// table        height x width integers of 64 bits
// row          height x 4 integers of 64 bits
//
// One work-item per band, 16 pixels at a time.

#include "common/prefix_sum.clh"

// Inclusive prefix sum of 16 integers of type T in registers (Hillis and Steele 1986).
#define SCAN_LANES(T, q)                \
    do {                                \
        const T##16 none_ = 0;          \
        q += BEFORE_1(T, none_, q);     \
        q += BEFORE_2(T, none_, q);     \
        q += BEFORE_4(T, none_, q);     \
        q += BEFORE_8(T, none_, q);     \
    } while (0)

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
        ulong heavy = 0, carry = 0;
        uint lit = 0;
        float largest = 0.0f;
        ulong16 heavy16 = 0ul;
        int16 lit16 = 0;
        float16 largest16 = 0.0f;
        for (uint x = 0; x < whole; x += LANES) {
            const float16 light = weights(of_row + 3 * (size_t)x, scale) * sine * quantum.x * quantum.y + 0.5f;
            largest16 = fmax(largest16, light);
            lit16 -= light >= 1.0f;  // true is all bits set
            const ulong16 q = convert_ulong16(convert_long16(light));
            heavy16 -= as_ulong16(q > cap);
            ulong16 sum = min(q, (ulong16)(cap));
            SCAN_LANES(ulong, sum);
            sum += carry;
            carry = sum.sf;
            if (y > first)
                sum += vload16(0, sums - width + x);
            vstore16(sum, 0, sums + x);
        }
        for (uint x = whole; x < width; ++x) {
            const float light = weight(of_row + 3 * (size_t)x, scale) * sine * quantum.x * quantum.y + 0.5f;
            largest = fmax(largest, light);
            const ulong q = (ulong)(long)light;
            lit += q != 0;
            heavy += q > cap;
            carry += min(q, cap);
            sums[x] = y > first ? carry + sums[(long)x - width] : carry;
        }

        SCAN_LANES(ulong, heavy16);
        SCAN_LANES(int, lit16);
        const float8 largest8 = fmax(largest16.lo, largest16.hi);
        const float4 largest4 = fmax(largest8.lo, largest8.hi);
        largest = fmax(largest, fmax(fmax(largest4.x, largest4.y), fmax(largest4.z, largest4.w)));
        heavy += heavy16.sf;
        vstore4((ulong4)(carry - heavy * cap, heavy, lit + lit16.sf, (ulong)(long)largest), y, row);
    }
}
