// Per-pixel Monte Carlo: the diffuse sphere with fresh light samples for every pixel.
//
//     image(n) = mean over samples of (albedo / pi) L(w) max(0, n . w) / pdf(w)
//              = mean of (L / (R + G + B)) max(0, n . w) x strength
//
// with w drawn as in sample.cl, whose density is proportional to R + G + B: the quotient lies in
// [0, 1], so nothing overflows whatever the range of the map.
//
// sum        resolution x resolution x 3, the samples so far; this adds samples begin .. end - 1
// strength   albedo / pi x flux of R + G + B over the map
//
// One work-item a pixel. Sample s of pixel i is point s of stream i, whatever ran before.

#include "sequence.clh"
#include "invert_cdf.clh"

kernel void render(global const uint *restrict row_cdf,
                   global const uint *restrict marginal_cdf,
                   global const float *restrict radiance,
                   global const float2 *restrict theta,
                   global const float2 *restrict phi,
                   const uint width,
                   const uint height,
                   const float scale,
                   const float strength,
                   const uint2 seed,
                   const uint begin,
                   const uint end,
                   global const uint2 *restrict disc,
                   const int resolution,
                   global float *restrict sum)
{
    const uint2 at = disc[get_global_id(0)];
    const uint index = at.y * resolution + at.x;
    const int a = 2 * (int)at.x + 1 - resolution, b = resolution - 2 * (int)at.y - 1;
    const float inverse_resolution = 1.0f / resolution;
    const float3 normal =
        (float3)(a, b, sqrt((float)(resolution * resolution - a * a - b * b))) * inverse_resolution;

    float3 mean = 0.0f;
    for (uint s = begin; s < end; ++s) {
        const uint2 u = sequence_point(s, 0u, index, seed);
        const uint y = invert_cdf(marginal_cdf, height, u.y);
        const uint x = invert_cdf(row_cdf + (size_t)y * width, width, u.x);
        const float2 t = theta[y], p = phi[x];
        const float cosine = dot(normal, (float3)(t.x * p.y, t.y, t.x * p.x));
        if (cosine > 0.0f) {
            const float3 L = vload3((size_t)y * width + x, radiance) * scale;
            mean += L * (cosine / (L.x + L.y + L.z));
        }
    }
    vstore3(vload3(index, sum) + mean * strength, index, sum);
}
