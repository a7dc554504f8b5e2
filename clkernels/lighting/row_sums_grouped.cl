// Prefix sums along the rows of an environment map on a GPU, bit for bit those of row_sums.cl.
//
//     q(x, y) = round(f(x, y) sin(theta_y) 2^k), f = scale (R + G + B): the light of a pixel
//     energy(x, y) = sum over i <= x of min(q(i, y), cap)
//     lit(x, y)    = number of i <= x with q(i, y) > 0
//     row(y)       = (sum of the q <= cap, number of q > cap, number of q > 0, largest q)
//
// Arguments: row_sums.cl. One group of GROUP work-items per row, each of which takes one pixel at a time.

#include "common/prefix_sum.clh"
#include "common/group_scan.clh"

__attribute__((reqd_work_group_size(GROUP, 1, 1)))
kernel void row_sums_grouped(global const float *restrict radiance,
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
    local ulong sums[GROUP];
    local uint lit_sums[GROUP];
    const uint i = get_local_id(0);
    const size_t y = get_global_id(0) / GROUP;
    if (again && row[4 * y + 3] <= cap)
        return;
    const float sine = sin_theta[y];
    radiance += y * width * 3;
    energy += y * width;
    lit += y * width;

    ulong below = 0, heavy = 0, largest = 0, energy_carry = 0, all;
    uint lit_carry = 0, lit_all;
    for (uint first = 0; first < width; first += GROUP) {
        const uint x = first + i;
        const float f = x < width ? weight(radiance + 3 * (size_t)x, scale) * sine : 0.0f;
        const ulong q = (ulong)(long)(f * quantum.x * quantum.y + 0.5f), e = min(q, cap);
        const uint l = q != 0;
        below += q > cap ? 0 : q;
        heavy += q > cap;
        largest = max(largest, q);
        const ulong energy_before = energy_carry + long_sum_before(e, sums, &all);
        const uint lit_before = lit_carry + sum_before(l, lit_sums, &lit_all);
        if (x < width) {
            energy[x] = energy_before + e;
            lit[x] = lit_before + l;
        }
        energy_carry += all;
        lit_carry += lit_all;
    }
    ulong below_all, heavy_all;
    long_sum_before(below, sums, &below_all);
    long_sum_before(heavy, sums, &heavy_all);
    barrier(CLK_LOCAL_MEM_FENCE);
    sums[i] = largest;
    barrier(CLK_LOCAL_MEM_FENCE);
    if (i == 0) {
        for (uint k = 1; k < GROUP; ++k)
            largest = max(largest, sums[k]);
        vstore4((ulong4)(below_all, heavy_all, lit_carry, largest), y, row);
    }
}
