// An environment map cut into cells on a GPU, bit for bit as cells.cl does it.
//
//     f = scale (R + G + B)        flux(cell) = sum over its pixels of f sin(theta)
//
// Each work-item makes the CDFs of some of the cell's rows. One of them then adds up the rows in order, as cells.cl
// does, since the last bits of float sums depend on the order.
//
// Arguments: cells.cl. One group of GROUP work-items per cell, from left to right, then from top to bottom.

#include "common/channels.clh"
#include "common/prefix_sum.clh"
#include "rendering/product.clh"

__attribute__((reqd_work_group_size(GROUP, 1, 1)))
kernel void cells_grouped(global const float *restrict radiance,
                          global const float2 *restrict theta,
                          global const float2 *restrict phi,
                          global const float *restrict spread,
                          const uint width,
                          const uint height,
                          const uint2 size,
                          const float scale,
                          global uint *restrict cell_row_cdf,
                          global uint *restrict cell_marginal_cdf,
                          global float *restrict flux,
                          global float4 *restrict cell_cones,
                          global float4 *restrict cell_colours)
{
    local float4 rows[GROUP];
    local float3 colours[GROUP];
    const uint i = get_local_id(0), index = get_global_id(0) / GROUP, across = (width + size.x - 1) / size.x;
    const uint2 cell = (uint2)(index % across, index / across);
    const uint2 first = cell * size, last = min(first + size, (uint2)(width, height));
    cell_marginal_cdf += (size_t)cell.x * height;

    float total = 0.0f;
    float3 axis = 0.0f, colour = 0.0f;
    for (uint begin = first.y; begin < last.y; begin += GROUP) {
        const uint y = begin + i;
        if (y < last.y) {
            const size_t row = (size_t)y * width;
            float sum = 0.0f;
            float2 along = 0.0f;
            float3 rgb = 0.0f;
            for (uint x = first.x; x < last.x; ++x) {
                const float3 L = vload3(row + x, radiance) * scale;
                const float f = L.x + L.y + L.z;
                cell_row_cdf[row + x] = as_uint(f);
                sum += f;
                along += f * phi[x];
                rgb += L;
            }
            weights_to_cdf(cell_row_cdf + row + first.x, last.x - first.x, sum);
            rows[i] = (float4)(sum, along, 0.0f);
            colours[i] = rgb;
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        if (i == 0)
            for (uint k = 0; k < min((uint)GROUP, last.y - begin); ++k) {
                const float2 t = theta[begin + k];
                const float g = rows[k].x * t.x;
                cell_marginal_cdf[begin + k] = as_uint(g);
                total += g;
                axis += t.x * (float3)(t.x * rows[k].z, t.y * rows[k].x, t.x * rows[k].y);
                colour += t.x * colours[k];
            }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
    if (i == 0) {
        weights_to_cdf(cell_marginal_cdf + first.y, last.y - first.y, total);
        axis = total > 0.0f ? plain_normalize(axis / total) : (float3)(0.0f, 1.0f, 0.0f);
        rows[0] = (float4)(axis, total);
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    axis = rows[0].xyz;
    total = rows[0].w;
    barrier(CLK_LOCAL_MEM_FENCE);

    const uint columns = last.x - first.x, pixels = columns * (last.y - first.y);
    float reach = 0.0f;
    for (uint k = i; k < pixels; k += GROUP) {
        const uint x = first.x + k % columns, y = first.y + k / columns;
        const float3 L = vload3((size_t)y * width + x, radiance);
        const float2 t = theta[y], p = phi[x];
        if (L.x + L.y + L.z > 0.0f)
            reach = fmax(reach, plain_distance(axis, (float3)(t.x * p.y, t.y, t.x * p.x)) + spread[y]);
    }
    rows[i].x = reach;
    barrier(CLK_LOCAL_MEM_FENCE);
    if (i == 0) {
        for (uint k = 1; k < GROUP; ++k)
            reach = fmax(reach, rows[k].x);
        flux[index] = total;
        cell_cones[index] = (float4)(axis, reach + 1e-6f);
#ifndef GREY
        cell_colours[index] = total > 0.0f ? (float4)(colour / total, 0.0f) : (float4)(0.0f);
#endif
    }
}
