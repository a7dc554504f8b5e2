// Draw directions as sample.cl does, with searches that start from guide tables: faster for many samples.
//
//     a strip, y from its CDF over rows, x from the CDF of row y in it,  p(x, y) = f(x, y) sin(theta_y) / total
//
// Other formulas, and the arguments: sample_block.clh. One work-item per BLOCK samples.

#include "sampling/sample_block.clh"

kernel void sample_guided(global const uint *restrict row_cdf,
                          global const uint *restrict marginal_cdf,
                          global const uint4 *restrict strips,
                          const uint strip_bits,
                          global const float *restrict radiance,
                          global const uint2 *restrict marginal_guide,
                          global const uint2 *restrict row_guide,
                          global const uint *restrict row_total,
                          const uint marginal_shift,
                          const uint row_shift,
                          global const float2 *restrict theta,
                          global const float2 *restrict phi,
                          global const ulong2 *restrict row_versines,
                          const uint width,
                          const uint height,
                          const float scale,
                          const float inverse_total,
                          const uint count,
                          const uint2 seed,
                          const uint generator,
                          global const ulong2 *restrict points,
                          global float *restrict direction,
                          global float *restrict sample_radiance,
                          global int *restrict pixel,
                          global float *restrict probability)
{
    const uint begin = get_global_id(0) * BLOCK, n = min((uint)BLOCK, count - begin);
    uint across[BLOCK], down[BLOCK], x[BLOCK], y[BLOCK];
    sequence_block(points, begin, count, generator, 0u, seed, across, down);
    const guided_map map = {strips, row_cdf, marginal_cdf, marginal_guide, row_guide, row_total, strip_bits,
                            marginal_shift, row_shift, width, height};
    pick_pixels(&map, across, down, n, x, y);
    block_directions w;
    block_centres(theta, phi, x, y, n, &w);
    store_samples(radiance, width, scale, inverse_total, x, y, w.sin_theta, begin, n, sample_radiance, pixel,
                  probability);
    move_within_pixels(row_cdf, marginal_cdf, strips, strip_bits, row_versines, points, width, height, count, seed,
                       across, down, x, y, begin, n, &w);
    store_directions(&w, begin, n, direction);
}
