// Prefix sums along the rows of an environment map, in integers: half of a summed-area table.
//
//     q(x, y) = round(f(x, y) sin(theta_y) 2^k), f = scale (R + G + B): the light of a pixel
//     energy(x, y) = sum over i <= x of min(q(i, y), cap)
//     lit(x, y)    = number of i <= x with q(i, y) > 0
//     row(y)       = (sum of the q <= cap, number of q > cap, number of q > 0)
//
// 2^k keeps the sum over the map below 2^63, so all sums and differences are exact, in any order, whatever the range
// of the map. column_sums.cl completes the table.
//
// radiance     height x width x 3 floats, finite and >= 0
// sin_theta    height floats
// quantum      two powers of two whose product is 2^k
// energy, lit  height x width
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
                     global ulong *restrict energy,
                     global uint *restrict lit,
                     global ulong *restrict row)
{
    const size_t y = get_global_id(0);
    const float sine = sin_theta[y];
    radiance += y * width * 3;
    energy += y * width;
    lit += y * width;

    ulong below = 0, heavy = 0, energy_carry = 0;
    uint lit_carry = 0;
    const uint whole = width - width % LANES;
    ulong16 below16 = 0ul, heavy16 = 0ul;
    for (uint x = 0; x < whole; x += LANES) {
        const float16 f = weights(radiance + 3 * (size_t)x, scale) * sine;
        const ulong16 q = convert_ulong16(convert_long16(f * quantum.x * quantum.y + 0.5f));
        const ulong16 over = as_ulong16(q > cap);  // all bits where true
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
    vstore3((ulong3)(below + below16.sf, heavy + heavy16.sf, lit_carry), y, row);
}
