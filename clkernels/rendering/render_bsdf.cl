// Per-pixel Monte Carlo of the diffuse sphere: directions drawn as the cosine.
//
//     image(n) = integral of (albedo / pi) L(w) max(0, n . w) dw
//
// Let F be the integral of S = R + G + B over the sphere of directions, and k = pi / F. The density is
// max(0, n . w) / pi, so the image is albedo F / pi times the mean over samples of
//
//     L k
//
// Directions fall anywhere in a pixel of the map, whose radiance is constant over its area, so this converges to the
// integral over areas (exact_areas.cl).
//
// radiance               height x width x 3 floats
// scale, k               a power of two that keeps S in float's range, and pi / F of the scaled map
// disc                   (x, y) of the pixels inside the disc, pixel_count of them
// seed                   of the sequence (sequence.clh); sample s of pixel i is point s of stream i, whatever ran before
// sum                    the image so far (image_sum.clh); this adds samples begin .. end - 1 of each pixel
//
// One work-item BLOCK pixels.

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
    const uint first = get_global_id(0) * BLOCK;
    uint index[BLOCK];
    block3 normal;
    block_pixels(disc, first, pixel_count, resolution, index, &normal);
    block_streams streams;
    begin_streams(&streams, index, begin, seed);

    float weight[BLOCK];
    for (uint i = 0; i < BLOCK; ++i)
        weight[i] = k;
    block_rgb samples = {{{0.0f}}};
    for (uint s = begin; s < end; ++s) {
        // The pixel of the map that a direction lies in, drawn as the cosine
        uint across[BLOCK], down[BLOCK], x[BLOCK], y[BLOCK];
        float cosine[BLOCK];
        next_points(&streams, s, seed, across, down);
        block_cosine_pixels(&normal, across, down, width, height, x, y, cosine);

        // L k
        block_rgb L;
        block_radiance(radiance, width, scale, x, y, &L);
        block_add(&samples, &L, weight);
    }
    block_store(&samples, index, min((uint)BLOCK, pixel_count - first), resolution, sum);
}
