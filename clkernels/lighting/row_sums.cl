// Prefix sums along the rows of an environment map, in integers: half of a summed-area table.
//
//     q(x, y) = round(f(x, y) sin(theta_y) 2^k), f = scale (R + G + B): the light of a pixel
//     energy(x, y) = sum over i <= x of min(q(i, y), cap)
//     lit(x, y)    = number of i <= x with q(i, y) > 0
//     row(y)       = (sum of the q <= cap, number of q > cap, number of q > 0, largest q)
//
// 2^k keeps the sum over the map below 2^63, so all sums and differences are exact, in any order, whatever the range
// of the map. column_sums.cl completes the table.
//
// radiance     height x width x 3 floats, finite and >= 0
// sin_theta    height floats
// scale        a power of two that keeps the sum over the map inside float's range
// quantum      two powers of two whose product is 2^k
// cap          the most that a pixel counts for, an equal share of the energy (median_cut.py)
// again        whether `row` holds the result of an earlier launch; rows with no pixel above the cap are then left alone
// energy, lit  height x width integers of 64 and 32 bits
// row          height x 4 integers of 64 bits
//
// One work-item per row, 16 pixels at a time.

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
                     const float scale,
                     const float2 quantum,
                     const ulong cap,
                     const uint again,
                     global ulong *restrict energy,
                     global uint *restrict lit,
                     global ulong *restrict row)
{
    const size_t y = get_global_id(0);
    if (again && row[4 * y + 3] <= cap)
        return;
    const float sine = sin_theta[y];
    radiance += y * width * 3;
    energy += y * width;
    lit += y * width;

    ulong below = 0, heavy = 0, energy_carry = 0;
    uint lit_carry = 0;
    float largest = 0.0f;
    const uint whole = width - width % LANES;
    ulong16 below16 = 0ul, heavy16 = 0ul;
    float16 largest16 = 0.0f;
    for (uint x = 0; x < whole; x += LANES) {
        const float16 f = weights(radiance + 3 * (size_t)x, scale) * sine;
        largest16 = fmax(largest16, f);
        const ulong16 q = convert_ulong16(convert_long16(f * quantum.x * quantum.y + 0.5f));
        const ulong16 over = as_ulong16(q > cap);  // true is all bits set
        below16 += q & ~over;
        heavy16 -= over;
        ulong16 e = min(q, (ulong16)(cap));
        SCAN_LANES(ulong, e);
        e += energy_carry;
        vstore16(e, 0, energy + x);
        energy_carry = e.sf;
        uint16 l = -as_uint16(convert_int16(q != (ulong16)(0ul)));
        SCAN_LANES(uint, l);
        l += lit_carry;
        vstore16(l, 0, lit + x);
        lit_carry = l.sf;
    }
    for (uint x = whole; x < width; ++x) {
        const float f = weight(radiance + 3 * (size_t)x, scale) * sine;
        largest = fmax(largest, f);
        const ulong q = (ulong)(long)(f * quantum.x * quantum.y + 0.5f);
        below += q > cap ? 0 : q;
        heavy += q > cap;
        energy_carry += min(q, cap);
        energy[x] = energy_carry;
        lit_carry += q != 0;
        lit[x] = lit_carry;
    }

    SCAN_LANES(ulong, below16);
    SCAN_LANES(ulong, heavy16);
    const float8 largest8 = fmax(largest16.lo, largest16.hi);
    const float4 largest4 = fmax(largest8.lo, largest8.hi);
    largest = fmax(largest, fmax(fmax(largest4.x, largest4.y), fmax(largest4.z, largest4.w)));
    const ulong largest_q = (ulong)(long)(largest * quantum.x * quantum.y + 0.5f);
    vstore4((ulong4)(below + below16.sf, heavy + heavy16.sf, lit_carry, largest_q), y, row);
}
