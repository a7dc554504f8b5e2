// Draw pixels as sample.cl does, with their probabilities but without directions and radiance.
//
//     a strip, y from its CDF over rows, x from the CDF of row y in it,  p(x, y) = f(x, y) sin(theta_y) / total
//
// Arguments: sample_block.clh. One work-item per BLOCK samples.

#include "sampling/sample_block.clh"

kernel void sample_pixels(global const uint *restrict row_cdf,
                          global const uint *restrict marginal_cdf,
                          global const uint4 *restrict strips,
                          const uint strip_bits,
                          global const float *restrict radiance,
                          global const float2 *restrict theta,
                          const uint width,
                          const uint height,
                          const float scale,
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
    search_pixels(row_cdf, marginal_cdf, strips, strip_bits, width, height, across, down, x, y);

    float red[BLOCK], green[BLOCK], blue[BLOCK], f[BLOCK];
    load_radiance(radiance, width, scale, x, y, n, red, green, blue, f);
    store_pixel_samples(f, theta, inverse_total, x, y, begin, n, pixel, probability);
}
