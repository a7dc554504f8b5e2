// Per-pixel Monte Carlo of the diffuse sphere: directions sampled by the light. Arguments: pixel_block.clh.
//
// The density is S / F, so the image is albedo F / pi times the mean over samples of
//
//     c L / S
//
// No term is above 1, so nothing overflows whatever the range of the map. Directions are centres of the map's pixels,
// as in sample.cl, so this converges to the sum over centres (exact.cl).
//
// One work-item per BLOCK pixels.

#include "common/guided.clh"
#include "rendering/pixel_block.clh"

kernel void render_light(global const float *restrict radiance,
                         global const uint *restrict row_cdf,
                         global const uint *restrict marginal_cdf,
                         global const uint4 *restrict strips,
                         const uint strip_bits,
                         global const uint2 *restrict marginal_guide,
                         global const uint2 *restrict row_guide,
                         global const uint *restrict row_total,
                         const uint marginal_shift,
                         const uint row_shift,
                         global const float2 *restrict theta,
                         global const float2 *restrict phi,
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
        // A pixel of the map, sampled by its light
        uint across[BLOCK], down[BLOCK], x[BLOCK], y[BLOCK];
        block_directions w;
        next_points(&block.streams, s, across, down);
        pick_pixels(&map, across, down, BLOCK, x, y);
        block_centres(theta, phi, x, y, BLOCK, &w);

        // c L / S
        float c[BLOCK];
        block_cosines(&block.normal, &w, c);
        block_add_colours(&block.samples, radiance, width, scale, x, y, c);
    }
    end_block(&block, pixel_count, resolution, sum);
}
