// Coarse CDFs of light times cosine on a GPU, bit for bit those of product_cdf.cl. The last bits of tile_moments may
// differ, which changes no sample.
//
//     g(cell) = flux(cell) C(tile, cell)        total = sum over cells of g(cell)
//
// Work-items share out the tile's normals, then the cells, then the rows of cells, of which there are at most GROUP.
// All other sums whose last bits depend on the order are left to a single work-item.
//
// Arguments: product_cdf.cl. One group of GROUP work-items per tile, from left to right, then from top to bottom.

#include "common/prefix_sum.clh"
#include "common/normal.clh"
#include "rendering/product.clh"

__attribute__((reqd_work_group_size(GROUP, 1, 1)))
kernel void product_cdf_grouped(global const float *restrict flux,
                                global const float4 *restrict cell_cones,
                                global const float4 *restrict cell_colours,
                                const uint2 cells,
                                const int tile_size,
                                const int resolution,
                                global float4 *restrict tile_cones,
                                global float *restrict total,
                                global uint *restrict tile_row_cdf,
                                global uint *restrict tile_marginal_cdf,
                                global float4 *restrict tile_moments)
{
    local float3 shared_axis;
    local float shared_reach;
    local float values[GROUP];
    local float4 shares[CHANNELS][GROUP];
    const uint i = get_local_id(0), count = (resolution + tile_size - 1) / tile_size;
    const size_t index = get_global_id(0) / GROUP;
    const int2 first = (int2)(index % count, index / count) * tile_size;
    const int2 last = min(first + tile_size, (int2)(resolution));  // Oclgrind's min of int2 and int is wrong
    const uint across = last.x - first.x, pixels = across * (last.y - first.y);
    tile_row_cdf += index * cells.y * cells.x;
    tile_marginal_cdf += index * cells.y;

    float3 axis = 0.0f;
    if (i == 0) {
        for (uint k = 0; k < pixels; ++k) {
            const float3 n = pixel_normal(first.x + k % across, first.y + k / across, resolution);
            axis += n.z > 0.0f ? n : (float3)(0.0f);
        }
        shared_axis = axis.z == 0.0f ? axis : plain_normalize(axis);
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    axis = shared_axis;
    if (axis.z == 0.0f)
        return;
    float reach = 0.0f;
    for (uint k = i; k < pixels; k += GROUP) {
        const float3 n = pixel_normal(first.x + k % across, first.y + k / across, resolution);
        if (n.z > 0.0f)
            reach = fmax(reach, plain_distance(n, axis));
    }
    values[i] = reach;
    barrier(CLK_LOCAL_MEM_FENCE);
    if (i == 0) {
        for (uint k = 1; k < GROUP; ++k)
            reach = fmax(reach, values[k]);
        shared_reach = reach + 1e-6f;
        tile_cones[index] = (float4)(axis, shared_reach);
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    reach = shared_reach;

    for (uint cell = i; cell < cells.x * cells.y; cell += GROUP) {
        const float4 cell_cone = cell_cones[cell];
        const float c = plain_dot(axis, cell_cone.xyz);
        tile_row_cdf[cell] = as_uint(flux[cell] * cosine_guess(c, reach + cell_cone.w));
    }
    barrier(CLK_GLOBAL_MEM_FENCE);
    if (i < cells.y) {
        global uint *row = tile_row_cdf + i * cells.x;
        const float sum = sum_in_lanes(row, cells.x);
        weights_to_cdf(row, cells.x, sum);
        tile_marginal_cdf[i] = as_uint(sum);
    }
    float4 moments[CHANNELS] = {0.0f};
    for (uint cell = i; cell < cells.x * cells.y; cell += GROUP) {
        const float4 m = cell_cones[cell];
        const float c = plain_dot(axis, m.xyz), d = reach + m.w;
        float a, b;
        cosine_line(c, d, &a, &b);
        const float4 moment = (float4)(a * m.xyz, b) * flux[cell];
#ifdef GREY
        moments[RED] += moment * (1.0f / 3.0f);
#else
        moments[RED] += moment * cell_colours[cell].x;
        moments[GREEN] += moment * cell_colours[cell].y;
        moments[BLUE] += moment * cell_colours[cell].z;
#endif
    }
    for (uint k = 0; k < CHANNELS; ++k)
        shares[k][i] = moments[k];
    barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
    if (i < CHANNELS) {
        float4 sum = 0.0f;
        for (uint k = 0; k < GROUP; ++k)
            sum += shares[i][k];
        tile_moments[index * CHANNELS + i] = sum;
    }
    if (i == 0) {
        const float sum = sum_in_lanes(tile_marginal_cdf, cells.y);
        weights_to_cdf(tile_marginal_cdf, cells.y, sum);
        total[index] = sum;
    }
}
