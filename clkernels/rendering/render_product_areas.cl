// Per-pixel Monte Carlo of the diffuse sphere, with directions sampled by light times cosine, approximately.
//
// As in render_product.cl, the image is, up to a factor, the mean over samples of
//
//     (L / S) (c / C) - q + the mean of q
//
// but directions are uniform over the solid angle of the map's pixels, so this converges to the integral over areas
// (exact_areas.cl). The cells' cones hold whole pixels (cells.cl).
//
// edge  cos(theta) at the height + 1 borders of rows
//
// Other arguments: product_block.clh. One work-item per BLOCK pixels.

#include "rendering/product_block.clh"

kernel void render_product_areas(global const uint *restrict tile_row_cdf,
                                 global const uint *restrict tile_marginal_cdf,
                                 global const float4 *restrict tile_cones,
                                 global const float *restrict tile_total,
                                 const uint tile_size,
                                 const uint tiles_across,
                                 global const uint *restrict cell_row_cdf,
                                 global const uint *restrict cell_marginal_cdf,
                                 global const float4 *restrict tile_moments,
                                 global const float4 *restrict cell_cones,
                                 global const float4 *restrict cell_colours,
                                 const uint2 cells,
                                 const uint2 cell_size,
                                 global const float *restrict radiance,
                                 global const float *restrict edge,
                                 const uint width,
                                 const uint height,
                                 const float scale,
                                 const float inverse_total,
                                 global const uint2 *restrict disc,
                                 const uint pixel_count,
                                 const uint2 seed,
                                 const uint begin,
                                 const uint end,
                                 const int resolution,
                                 global float *restrict sum)
{
    const product_cdfs cdfs = {tile_row_cdf, tile_marginal_cdf, tile_cones, tile_total, tile_size, tiles_across,
                               cell_row_cdf, cell_marginal_cdf, tile_moments, cell_cones, cell_colours, cells, cell_size,
                               width, height};
    pixel_block block;
    block_tiles tiles;
    begin_block(&block, disc, pixel_count, begin, seed, resolution);
    begin_tiles(&cdfs, &block, resolution, &tiles);
    for (uint s = begin; s < end; ++s) {
        // A cell (i, j), and a pixel (x, y) of the map in it
        uint across[BLOCK], down[BLOCK], i[BLOCK], j[BLOCK], x[BLOCK], y[BLOCK];
        next_points(&block.streams, s, across, down);
        pick_cells(&cdfs, &tiles, across, down, i, j);
        float place_across[BLOCK], place_down[BLOCK];
        pick_in_cells(&cdfs, i, j, across, down, x, y, place_across, place_down);

        // (L / S) (c / C) - q + the mean of q
        block_directions w;
        float_directions(edge, width, x, y, place_across, place_down, &w);
        add_samples(&cdfs, &tiles, i, j, &w, radiance, scale, x, y, &block);
    }
    end_product(&tiles, inverse_total, &block, pixel_count, resolution, sum);
}
