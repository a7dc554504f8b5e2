// Draw pixels as sample_pixels.cl does, with searches that start from guide tables: faster for many samples.
//
//     a strip, y from its CDF over rows, x from the CDF of row y in it,  p(x, y) = f(x, y) sin(theta_y) / total
//
// f  height x width floats, from map_weights.cl: read in place of the radiance
//
// Other arguments: sample_block.clh. One work-item per BLOCK samples.

#include "sampling/sample_block.clh"

kernel void sample_pixels_guided(global const uint *restrict row_cdf,
                                 global const uint *restrict marginal_cdf,
                                 global const uint4 *restrict strips,
                                 const uint strip_bits,
                                 global const float *restrict f,
                                 global const uint2 *restrict marginal_guide,
                                 global const uint2 *restrict row_guide,
                                 global const uint *restrict row_total,
                                 const uint marginal_shift,
                                 const uint row_shift,
                                 global const float2 *restrict theta,
                                 const uint width,
                                 const uint height,
                                 const float inverse_total,
                                 const uint count,
                                 const uint2 seed,
                                 const uint generator,
                                 global const ulong2 *restrict points,
                                 global int *restrict pixel,
                                 global float *restrict probability)
{
    const uint begin = get_global_id(0) * BLOCK, n = min((uint)BLOCK, count - begin);
    uint across[BLOCK], down[BLOCK], x[BLOCK], y[BLOCK];
    sequence_block(points, begin, count, generator, 0u, seed, across, down);
    const guided_map map = {strips, row_cdf, marginal_cdf, marginal_guide, row_guide, row_total, strip_bits,
                            marginal_shift, row_shift, width, height};
    pick_pixels(&map, across, down, n, x, y);

    float weight[BLOCK];
    load_weights(f, width, x, y, n, weight);
    store_pixel_samples(weight, theta, inverse_total, x, y, begin, n, pixel, probability);
}
