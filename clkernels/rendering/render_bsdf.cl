// Per-pixel Monte Carlo of the diffuse sphere: directions sampled by the cosine. Arguments: pixel_block.clh.
//
// The density is c / pi, so the image is albedo F / pi times the mean over samples of
//
//     L k
//
// Directions fall anywhere in a pixel of the map, whose radiance is constant over its area, so this converges to the
// integral over areas (exact_areas.cl).
//
// One work-item per BLOCK pixels.

#include "rendering/cosine_block.clh"

kernel void render_bsdf(global const float *restrict radiance,
                        const uint width,
                        const uint height,
                        const float scale,
                        const float k,
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

    float weight[BLOCK];
    for (uint i = 0; i < BLOCK; ++i)
        weight[i] = k;
    for (uint s = begin; s < end; ++s) {
        // The pixel of the map in which a direction sampled by the cosine lies
        uint across[BLOCK], down[BLOCK], x[BLOCK], y[BLOCK];
        float cosine[BLOCK];
        next_points(&block.streams, s, across, down);
        block_cosine_pixels(&block.normal, across, down, width, height, x, y, cosine);

        // L k
        block_rgb L;
        block_radiance(radiance, width, scale, x, y, &L);
        block_add(&block.samples, &L, weight);
    }
    end_block(&block, pixel_count, resolution, sum);
}
