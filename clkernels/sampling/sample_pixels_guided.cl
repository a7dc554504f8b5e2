// Draw pixels with their probabilities, by searches that begin at guide tables: quicker for many samples.
//
//     y from the CDF over rows, x from the CDF of row y (Pharr et al., 4th ed., A.4 and A.5)
//     p(x, y) = f(x, y) sin(theta_y) / total, from the pixel's own weight
//
// row_cdf, marginal_cdf  height x width and height integers, from row_cdf.cl and marginal_cdf.cl
// f                      height x width floats, from map_weights.cl
// marginal_guide, row_guide, row_total
//                        guide tables of both CDFs, and the last entry of each row's CDF, from guide.cl
// marginal_shift, row_shift
//                        a bucket of a guide is u >> shift
// theta                  (sin, cos) of every row
// inverse_total          1 / the sum of f sin(theta) over the map
// seed                   of the sequence that the points come from (sequence.clh)
// pixel                  count x (x, y)
// probability            count floats
//
// One work-item BLOCK samples.

#include "common/guided.clh"
#include "common/sequence.clh"
#include "sampling/sample_block.clh"

kernel void sample_pixels_guided(global const uint *restrict row_cdf,
                                 global const uint *restrict marginal_cdf,
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
                                 global int *restrict pixel,
                                 global float *restrict probability)
{
    const uint begin = get_global_id(0) * BLOCK, n = min((uint)BLOCK, count - begin);

    // A point of the unit square for each sample
    uint across[BLOCK], down[BLOCK];
    sequence_block(begin, count, 0u, seed, across, down);

    // The pixel that it picks: y from the CDF over rows, x from the CDF of row y
    uint x[BLOCK], y[BLOCK];
    const guided_map map = {row_cdf, marginal_cdf, marginal_guide, row_guide, row_total, marginal_shift, row_shift,
                            width, height};
    pick_pixels(&map, across, down, n, x, y);

    // f and sin(theta) there
    float weight[BLOCK], sin_theta[BLOCK];
    for (uint k = 0; k < n; ++k)
        prefetch_line(f + (size_t)y[k] * width + x[k]);
    SCALAR_LOADS
    for (uint k = 0; k < n; ++k)
        weight[k] = f[(size_t)y[k] * width + x[k]];
    SCALAR_LOADS
    for (uint k = 0; k < n; ++k)
        sin_theta[k] = theta[y[k]].x;

    // Its probability f sin(theta) / total
    store_pixels(x, y, begin, n, pixel);
    store_probabilities(weight, sin_theta, inverse_total, begin, n, probability);
}
