// The CDF over the rows of an environment map on a GPU, bit for bit that of marginal_cdf.cl.
//
//     g(y) = sin(theta_y) row_sum(y)     total = sum over y of g(y)
//     cdf(y) = prefix sum over y of g(y) as integers (prefix_sum.clh)
//
// The total's last bits depend on the order of summation, so a single work-item adds up the rows in order, from local
// memory. All work-items share the rest.
//
// Arguments: marginal_cdf.cl. A single group of GROUP work-items.

#include "common/prefix_sum.clh"
#include "common/group_scan.clh"

__attribute__((reqd_work_group_size(GROUP, 1, 1)))
kernel void marginal_cdf_grouped(global const float2 *restrict row_sum,
                                 global const float *restrict sin_theta,
                                 const uint height,
                                 global uint *restrict cdf,
                                 global float2 *restrict total)
{
    local float2 terms[GROUP];
    local uint sums[GROUP];
    const uint i = get_local_id(0);
    float2 sum = (float2)(0.0f);
    for (uint first = 0; first < height; first += GROUP) {
        const uint y = first + i;
        if (y < height) {
            const float2 r = row_sum[y];
            const float s = sin_theta[y];
            const float hi = r.x * s;
            terms[i] = (float2)(hi, fma(r.x, s, -hi) + r.y * s);
            cdf[y] = as_uint(hi);
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        if (i == 0) {
            const uint n = min((uint)GROUP, height - first);
#pragma unroll 8
            for (uint k = 0; k < n; ++k)
                sum = double_word_sum(sum, terms[k]);
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
    if (i == 0)
        *total = terms[0] = sum;
    barrier(CLK_LOCAL_MEM_FENCE);

    const float2 scale = quantisation(terms[0].x);
    uint carry = 0;
    for (uint first = 0; first < height; first += GROUP) {
        const uint y = first + i;
        const uint q = y < height ? quantise_one(as_float(cdf[y]), scale) : 0;
        uint all;
        const uint before = sum_before(q, sums, &all);
        if (y < height)
            cdf[y] = carry + before + q;
        carry += all;
    }
}
