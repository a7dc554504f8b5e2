// Sums over the rows of an environment map from the left on a GPU: row_sums.cl with bands of one row, bit for bit.
//
//     q(x, y) = round(f(x, y) sin(theta_y) 2^k), f = scale (R + G + B): the light of a pixel
//     table(x, y) = sum over i <= x of min(q(i, y), cap)
//     row(y)      = (sum of the q <= cap, number of q > cap, number of q > 0, largest q)
//
// Arguments: row_sums.cl. One group of GROUP work-items per row, each of which takes one pixel at a time.

#include "common/prefix_sum.clh"
#include "common/group_scan.clh"

__attribute__((reqd_work_group_size(GROUP, 1, 1)))
kernel void row_sums_grouped(global const float *restrict radiance,
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
    local ulong sums[GROUP];
    const uint i = get_local_id(0);
    const size_t y = get_global_id(0) / GROUP;
    const bool stays = again && row[4 * y + 3] <= cap;
    barrier(CLK_GLOBAL_MEM_FENCE);  // all work-items have read `row` before one of them writes to it
    if (stays)
        return;
    const float sine = sin_theta[y];
    radiance += y * width * 3;
    table += y * width;

    ulong heavy = 0, lit = 0, largest = 0, carry = 0, all;
    for (uint first = 0; first < width; first += GROUP) {
        const uint x = first + i;
        const float f = x < width ? weight(radiance + 3 * (size_t)x, scale) * sine : 0.0f;
        const ulong q = (ulong)(long)(f * quantum.x * quantum.y + 0.5f), e = min(q, cap);
        lit += q != 0;
        heavy += q > cap;
        largest = max(largest, q);
        const ulong before = carry + long_sum_before(e, sums, &all);
        if (x < width)
            table[x] = before + e;
        carry += all;
    }
    ulong lit_all, heavy_all;
    long_sum_before(lit, sums, &lit_all);
    long_sum_before(heavy, sums, &heavy_all);
    barrier(CLK_LOCAL_MEM_FENCE);
    sums[i] = largest;
    barrier(CLK_LOCAL_MEM_FENCE);
    if (i == 0) {
        for (uint k = 1; k < GROUP; ++k)
            largest = max(largest, sums[k]);
        vstore4((ulong4)(carry - heavy_all * cap, heavy_all, lit_all, largest), y, row);
    }
}
