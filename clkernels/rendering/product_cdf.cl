// Coarse CDFs of light times cosine: for every tile of the image, over the cells of the map.
//
//     g(cell) = flux(cell) C(tile, cell)        total = sum over cells of g(cell)
//
// flux, cell_cones, cell_colours
//                    from cells.cl, cells.y x cells.x; for C see product.clh
// tile_cones         (axis, reach) of the normals of every tile that meets the disc
// total              one float per tile; zeroed by the host, and stays 0 for a tile outside the disc
// tile_row_cdf       a tile's cells.y x cells.x integers (prefix_sum.clh), over the cells of one row
// tile_marginal_cdf  a tile's cells.y integers, over its rows of cells
// tile_moments       CHANNELS vectors per tile: the sum of flux(cell) h m over the cells with c >= d (product.clh)
//
// One work-item per tile of tile_size x tile_size pixels.

#include "common/prefix_sum.clh"
#include "common/normal.clh"
#include "rendering/product.clh"

// The mean normal of the tile's pixels, and the distance of the farthest normal from it; 0 outside the disc.
static inline float4 bound_normals(int2 tile, int tile_size, int resolution)
{
    const int2 first = tile * tile_size, last = min(first + tile_size, resolution);
    float3 axis = 0.0f;
    for (int y = first.y; y < last.y; ++y)
        for (int x = first.x; x < last.x; ++x) {
            const float3 n = pixel_normal(x, y, resolution);
            axis += n.z > 0.0f ? n : (float3)(0.0f);
        }
    if (axis.z == 0.0f)
        return (float4)(0.0f);
    axis = plain_normalize(axis);
    float reach = 0.0f;
    for (int y = first.y; y < last.y; ++y)
        for (int x = first.x; x < last.x; ++x) {
            const float3 n = pixel_normal(x, y, resolution);
            if (n.z > 0.0f)
                reach = fmax(reach, plain_distance(n, axis));
        }
    return (float4)(axis, reach + 1e-6f);
}

kernel void product_cdf(global const float *restrict flux,
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
    const size_t index = get_global_id(1) * get_global_size(0) + get_global_id(0);
    const float4 tile_cone = bound_normals((int2)(get_global_id(0), get_global_id(1)), tile_size, resolution);
    if (tile_cone.w == 0.0f)
        return;
    tile_cones[index] = tile_cone;
    tile_row_cdf += index * cells.y * cells.x;
    tile_marginal_cdf += index * cells.y;

    float sum = 0.0f;
    cell_moments moments = {{0.0f}};
    for (uint j = 0; j < cells.y; ++j) {
        float row_sum = 0.0f;
        cell_moments of_row = {{0.0f}};
        for (uint i = 0; i < cells.x; ++i) {
            const uint cell = j * cells.x + i;
            const float4 cell_cone = cell_cones[cell];
            const float c = plain_dot(tile_cone.xyz, cell_cone.xyz);
            const float d = tile_cone.w + cell_cone.w;
            const float g = flux[cell] * cosine_guess(c, d);
            tile_row_cdf[cell] = as_uint(g);
            row_sum += g;
            if (c >= d)
                add_moment(&of_row, flux[cell], cell_cone, cell_colours, cell);
        }
        for (uint k = 0; k < CHANNELS; ++k)
            moments.channel[k] += of_row.channel[k];
        weights_to_cdf(tile_row_cdf + j * cells.x, cells.x, row_sum);
        tile_marginal_cdf[j] = as_uint(row_sum);
    }
    for (uint j = 0; j < cells.y; ++j)  // of what is stored: summed above, it has other last digits on Intel's OpenCL
        sum += as_float(tile_marginal_cdf[j]);
    weights_to_cdf(tile_marginal_cdf, cells.y, sum);
    total[index] = sum;
    for (uint k = 0; k < CHANNELS; ++k)
        tile_moments[index * CHANNELS + k] = (float4)(moments.channel[k], 0.0f);
}
