// Per-pixel Monte Carlo of the diffuse sphere: directions sampled by the light. Arguments: pixel_block.clh, and edge.
//
// As in render_light.cl, the image is albedo F / pi times the mean over samples of
//
//     c L / S
//
// but directions are uniform over the solid angle of the map's pixels, so this converges to the integral over areas
// (exact_areas.cl).
//
// edge  cos(theta) at the height + 1 borders of rows
//
// One work-item per BLOCK pixels.

#include "rendering/pixel_places.clh"

kernel void render_light_areas(global const float *restrict radiance,
                               global const uint *restrict row_cdf,
                               global const uint *restrict marginal_cdf,
                               global const uint4 *restrict strips,
                               const uint strip_bits,
                               global const uint2 *restrict marginal_guide,
                               global const uint2 *restrict row_guide,
                               global const uint *restrict row_total,
                               const uint marginal_shift,
                               const uint row_shift,
                               global const float *restrict edge,
                               const uint width,
                               const uint height,
                               const float scale,
                               global const uint2 *restrict disc,
                               const uint pixel_count,
                               const uint2 seed,
                               const uint begin,
                               const uint end,
                               const int resolution,
                               global float *restrict sum)
{
    pixel_block block;
    begin_block(&block, disc, pixel_count, begin, seed, resolution);
    const guided_map map = {strips, row_cdf, marginal_cdf, marginal_guide, row_guide, row_total, strip_bits,
                            marginal_shift, row_shift, width, height};
    for (uint s = begin; s < end; ++s) {
        // A pixel of the map, sampled by its light, and a direction in it
        uint across[BLOCK], down[BLOCK], x[BLOCK], y[BLOCK];
        block_directions w;
        next_points(&block.streams, s, across, down);
        pick_directions(&map, edge, across, down, x, y, &w);

        // c L / S
        float c[BLOCK];
        block_cosines(&block.normal, &w, c);
        block_add_colours(&block.samples, radiance, width, scale, x, y, c);
    }
    end_block(&block, pixel_count, resolution, sum);
}
