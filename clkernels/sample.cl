// Draw directions from an environment map with probability proportional to luminance x sin(theta).
//
//     y from the CDF over rows, x from the CDF of row y (Pharr et al., 4th ed., A.4 and A.5)
//     p(x, y) = f(x, y) sin(theta_y) / total, from the pixel's own weight
//     direction = (sin theta cos phi, cos theta, sin theta sin phi)
//
// row_cdf, marginal_cdf   from row_cdf.cl and marginal_cdf.cl
// radiance                height x width x 3
// with GUIDED             searches begin at guide tables (guide.cl)
// theta, phi              (sin, cos) of every row and of every column
// scale, inverse_total    powers and reciprocals that make p a probability
// points                  (count, 2) fractions of 2^32 instead of the sequence
//
// One work-item BLOCK samples, in short loops that compilers turn into vectors.

#include "guided.clh"
#ifndef SEQUENCE_GIVEN
#include "sequence.clh"
#endif
#include "invert_cdf.clh"

#pragma OPENCL FP_CONTRACT OFF

kernel void sample(global const uint *restrict row_cdf,
                   global const uint *restrict marginal_cdf,
                   global const float *restrict radiance,
#ifdef GUIDED
                   global const guide_index *restrict marginal_guide,
                   global const guide_index *restrict row_guide,
                   global const uint *restrict row_total,
                   const uint marginal_shift,
                   const uint row_shift,
#endif
                   global const float2 *restrict theta,
                   global const float2 *restrict phi,
                   const uint width,
                   const uint height,
                   const float scale,
                   const float inverse_total,
                   const uint count,
#ifdef SEQUENCE_GIVEN
                   global const uint2 *restrict points,
#else
                   const uint2 seed,
#endif
                   global int *restrict pixel,
                   global float *restrict probability,
                   global float *restrict direction,
                   global float *restrict sample_radiance)
{
    const uint begin = get_global_id(0) * BLOCK, n = min((uint)BLOCK, count - begin);
    uint across[BLOCK], down[BLOCK], x[BLOCK], y[BLOCK];
#ifdef SEQUENCE_GIVEN
    for (uint k = 0; k < n; ++k) {
        across[k] = points[begin + k].x;
        down[k] = points[begin + k].y;
    }
#else
    for (uint k = 0; k < BLOCK; ++k)
        x[k] = begin + k;
    sequence_block(x, count, 0u, seed, across, down);
#endif

#ifdef GUIDED
    const guided_map map = {row_cdf,   marginal_cdf,   marginal_guide, row_guide, row_total,
                            marginal_shift, row_shift, width,          height};
    uint target_x[BLOCK], target_y[BLOCK];
    pick_pixels(&map, across, down, n, x, y, target_x, target_y);
#else
    for (uint k = 0; k < n; ++k) {
        y[k] = invert_cdf(marginal_cdf, height, down[k]);
        x[k] = invert_cdf(row_cdf + (size_t)y[k] * width, width, across[k]);
    }
#endif

    for (uint k = 0; k < n; ++k)
        PREFETCH(radiance + 3 * ((size_t)y[k] * width + x[k]));
    float red[BLOCK], green[BLOCK], blue[BLOCK];
    float sin_theta[BLOCK], cos_theta[BLOCK], sin_phi[BLOCK], cos_phi[BLOCK];
    GATHER
    for (uint k = 0; k < n; ++k) {
        const size_t i = (size_t)y[k] * width + x[k];
        const float3 L = vload3(i, radiance);
        red[k] = L.x;
        green[k] = L.y;
        blue[k] = L.z;
    }
    GATHER
    for (uint k = 0; k < n; ++k) {
        const float2 t = theta[y[k]], p = phi[x[k]];
        sin_theta[k] = t.x;
        cos_theta[k] = t.y;
        sin_phi[k] = p.x;
        cos_phi[k] = p.y;
    }

    for (uint k = 0; k < n; ++k) {
        const size_t i = begin + k;
        pixel[2 * i] = x[k];
        pixel[2 * i + 1] = y[k];
    }
    for (uint k = 0; k < n; ++k) {
        const float f = red[k] * scale + green[k] * scale + blue[k] * scale;
        probability[begin + k] = f * (sin_theta[k] * inverse_total);
    }
    for (uint k = 0; k < n; ++k) {
        const size_t i = begin + k;
        direction[3 * i] = sin_theta[k] * cos_phi[k];
        direction[3 * i + 1] = cos_theta[k];
        direction[3 * i + 2] = sin_theta[k] * sin_phi[k];
    }
    for (uint k = 0; k < n; ++k) {
        const size_t i = begin + k;
        sample_radiance[3 * i] = red[k];
        sample_radiance[3 * i + 1] = green[k];
        sample_radiance[3 * i + 2] = blue[k];
    }
}
