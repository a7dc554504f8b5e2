// The directions that given points draw, by searches that begin at guide tables: quicker for many samples.
//
//     y from the CDF over rows, x from the CDF of row y (Pharr et al., 4th ed., A.4 and A.5)
//     p(x, y) = f(x, y) sin(theta_y) / total, from the pixel's own weight
//     w = (sin theta cos phi, cos theta, sin theta sin phi)
//
// row_cdf, marginal_cdf  height x width and height integers, from row_cdf.cl and marginal_cdf.cl
// radiance               height x width x 3 floats
// marginal_guide, row_guide, row_total
//                        guide tables of both CDFs, and the last entry of each row's CDF, from guide.cl
// marginal_shift, row_shift
//                        a bucket of a guide is u >> shift
// theta, phi             (sin, cos) of every row and of every column
// scale, inverse_total   f = scale (R + G + B), and 1 / the sum of f sin(theta) over the map
// points                 count x (across, down), fractions of 2^32
// direction              count x 3 floats, unit vectors w
// sample_radiance        count x 3 floats
// pixel                  count x (x, y)
// probability            count floats
//
// One work-item BLOCK samples.

#include "common/guided.clh"
#include "sampling/sample_block.clh"

kernel void sample_at_guided(global const uint *restrict row_cdf,
                             global const uint *restrict marginal_cdf,
                             global const float *restrict radiance,
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
                             const float inverse_total,
                             const uint count,
                             global const uint2 *restrict points,
                             global float *restrict direction,
                             global float *restrict sample_radiance,
                             global int *restrict pixel,
                             global float *restrict probability)
{
    const uint begin = get_global_id(0) * BLOCK, n = min((uint)BLOCK, count - begin);

    // A point of the unit square for each sample
    uint across[BLOCK], down[BLOCK];
    load_points(points, begin, n, across, down);

    // The pixel that it picks: y from the CDF over rows, x from the CDF of row y
    uint x[BLOCK], y[BLOCK];
    const guided_map map = {row_cdf, marginal_cdf, marginal_guide, row_guide, row_total, marginal_shift, row_shift,
                            width, height};
    pick_pixels(&map, across, down, n, x, y);

    // Its probability, direction and radiance
    store_samples(radiance, theta, phi, width, scale, inverse_total, x, y, begin, n, direction, sample_radiance, pixel,
                  probability);
}
