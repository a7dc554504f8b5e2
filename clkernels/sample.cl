// Draw directions from an environment map with probability proportional to luminance x sin(theta).
//
//     y from the CDF over rows, x from the CDF of row y (Pharr et al., 4th ed., A.4 and A.5)
//     p(x, y) = f(x, y) sin(theta_y) / total, from the pixel's own weight
//     direction = (sin theta cos phi, cos theta, sin theta sin phi)
//
// row_cdf, marginal_cdf   from row_cdf.cl and marginal_cdf.cl
// radiance                height x width x 3
// theta, phi              (sin, cos) of every row and of every column
// scale, inverse_total    powers and reciprocals that make p a probability
// points                  (count, 2) fractions of 2^32 instead of count and seed
//
// One work-item a sample.

#ifndef SEQUENCE_GIVEN
#include "sequence.clh"
#endif
#include "invert_cdf.clh"

#pragma OPENCL FP_CONTRACT OFF

kernel void sample(global const uint *restrict row_cdf,
                   global const uint *restrict marginal_cdf,
                   global const float *restrict radiance,
                   global const float2 *restrict theta,
                   global const float2 *restrict phi,
                   const uint width,
                   const uint height,
                   const float scale,
                   const float inverse_total,
#ifdef SEQUENCE_GIVEN
                   global const uint2 *restrict points,
#else
                   const uint count,
                   const uint2 seed,
#endif
                   global int *restrict pixel,
                   global float *restrict probability,
                   global float *restrict direction,
                   global float *restrict sample_radiance)
{
    const uint i = get_global_id(0);
#ifdef SEQUENCE_GIVEN
    const uint2 u = points[i];
#else
    const uint2 u = sequence_point(i, count, 0u, seed);
#endif

    const uint y = invert_cdf(marginal_cdf, height, u.y);
    const uint x = invert_cdf(row_cdf + (size_t)y * width, width, u.x);

    const float3 L = vload3((size_t)y * width + x, radiance);
    const float2 t = theta[y], p = phi[x];
    const float f = L.x * scale + L.y * scale + L.z * scale;

    vstore2((int2)(x, y), i, pixel);
    probability[i] = f * (t.x * inverse_total);
    vstore3((float3)(t.x * p.y, t.y, t.x * p.x), i, direction);
    vstore3(L, i, sample_radiance);
}
