// Per-pixel Monte Carlo of the diffuse sphere: directions drawn as the light is.
//
//     image(n) = integral of (albedo / pi) L(w) max(0, n . w) dw
//
// Let c = max(0, n . w), S = R + G + B, and F the integral of S over the sphere of directions. The density is S / F, so
// the image is albedo F / pi times the mean over samples of
//
//     c L / S
//
// No term is above 1, so nothing overflows whatever the range of the map. Directions are centres of the map's pixels,
// as in sample.cl, so this converges to the sum over centres (exact.cl).
//
// radiance               height x width x 3 floats
// row_cdf, marginal_cdf  height x width and height integers, from row_cdf.cl and marginal_cdf.cl
// marginal_guide, row_guide, row_total, marginal_shift, row_shift
//                        their guide tables, from guide.cl
// theta, phi             (sin, cos) of every row and of every column
// scale                  a power of two that keeps S in float's range
// disc                   (x, y) of the pixels inside the disc, pixel_count of them
// seed                   of the sequence (sequence.clh); sample s of pixel i is point s of stream i, whatever ran before
// sum                    the image so far (image_sum.clh); this adds samples begin .. end - 1 of each pixel
//
// One work-item BLOCK pixels.

#include "common/guided.clh"
#include "rendering/pixel_block.clh"

kernel void render_light(global const float *restrict radiance,
                         global const uint *restrict row_cdf,
                         global const uint *restrict marginal_cdf,
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
    const uint first = get_global_id(0) * BLOCK;
    uint index[BLOCK];
    block3 normal;
    block_pixels(disc, first, pixel_count, resolution, index, &normal);
    block_streams streams;
    begin_streams(&streams, index, begin, seed);

    const guided_map map = {row_cdf, marginal_cdf, marginal_guide, row_guide, row_total, marginal_shift, row_shift,
                            width, height};
    block_rgb samples = {{{0.0f}}};
    for (uint s = begin; s < end; ++s) {
        // A pixel of the map, drawn as its light
        uint across[BLOCK], down[BLOCK], x[BLOCK], y[BLOCK];
        next_points(&streams, s, seed, across, down);
        pick_pixels(&map, across, down, BLOCK, x, y);

        // c = max(0, n . w), w = (sin theta cos phi, cos theta, sin theta sin phi)
        float sin_theta[BLOCK], cos_theta[BLOCK], sin_phi[BLOCK], cos_phi[BLOCK], c[BLOCK];
        block_directions(theta, phi, x, y, sin_theta, cos_theta, sin_phi, cos_phi);
        for (uint k = 0; k < BLOCK; ++k) {
            const float across_y = normal.x[k] * cos_phi[k] + normal.z[k] * sin_phi[k];
            c[k] = fmax(sin_theta[k] * across_y + normal.y[k] * cos_theta[k], 0.0f);
        }

        // c L / S
        block_add_colours(&samples, radiance, width, scale, x, y, c);
    }
    block_store(&samples, index, min((uint)BLOCK, pixel_count - first), resolution, sum);
}
