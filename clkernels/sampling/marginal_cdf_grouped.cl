// The CDFs over the rows of an environment map on a GPU, bit for bit those of marginal_cdf.cl.
//
//     g(y, s) = sin(theta_y) row_sum(y, s)     total(s) = sum over y of g(y, s)
//     cdf(s, y) = prefix sum over y of g(y, s) as integers (prefix_sum.clh)
//
// marginal_cdf.cl sums a strip in 16 lanes, each of which adds every 16th row. For the same rounding, 16 work-items take
// the part of one lane each, from local memory. All work-items share the rest.
//
// Arguments: marginal_cdf.cl. One group of GROUP work-items per strip.

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
    local float lanes[2 * LANES];
    local uint sums[GROUP];
    const uint i = get_local_id(0);
    const size_t strip = get_global_id(0) / GROUP;
    row_sum += strip * height;
    cdf += strip * height;

    float hi = 0.0f, lo = 0.0f;
    for (uint first = 0; first < height; first += GROUP) {
        const uint y = first + i;
        if (y < height) {
            const float2 r = row_sum[y];
            const float s = sin_theta[y], g = r.x * s;
            terms[i] = (float2)(g, fma(r.x, s, -g) + r.y * s);
            cdf[y] = as_uint(g);
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        if (i < LANES) {
            const uint n = min((uint)GROUP, height - first);
#pragma unroll 8
            for (uint k = i; k < n; k += LANES) {
                COMPENSATED_ADD(float, hi, lo, terms[k].x);
                lo += terms[k].y;
            }
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
    if (i < LANES) {
        lanes[i] = hi;
        lanes[LANES + i] = lo;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    if (i == 0)
        total[strip] = terms[0] = sum_of_lanes_in_order(vload16(0, lanes), vload16(1, lanes));
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
