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
// with PIXELS             pixels and probabilities only; with GUIDED too, radiance holds f (map_weights.cl)
//
// One work-item BLOCK samples, in short loops that compilers turn into vectors.

#include "common/block_search.clh"
#include "common/guided.clh"
#ifndef SEQUENCE_GIVEN
#include "common/sequence.clh"
#endif
#include "common/stream.clh"

#pragma OPENCL FP_CONTRACT OFF

kernel void sample(global const uint *restrict row_cdf,
                   global const uint *restrict marginal_cdf,
                   global const float *restrict radiance,
#ifdef GUIDED
                   global const uint2 *restrict marginal_guide,
                   global const uint2 *restrict row_guide,
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
#ifndef PIXELS
                   global float *restrict direction,
                   global float *restrict sample_radiance,
#endif
                   global int *restrict pixel,
                   global float *restrict probability)
{
    const uint begin = get_global_id(0) * BLOCK, n = min((uint)BLOCK, count - begin);
    uint across[BLOCK], down[BLOCK], x[BLOCK], y[BLOCK];
#ifdef SEQUENCE_GIVEN
    for (uint k = 0; k < BLOCK; ++k) {
        const uint2 u = k < n ? points[begin + k] : (uint2)(0u);
        across[k] = u.x;
        down[k] = u.y;
    }
#else
    sequence_block(begin, count, 0u, seed, across, down);
#endif

#ifdef GUIDED
    const guided_map map = {row_cdf,   marginal_cdf,   marginal_guide, row_guide, row_total,
                            marginal_shift, row_shift, width,          height};
    pick_pixels(&map, across, down, n, x, y);
#else
    uint base[BLOCK], last[BLOCK], total[BLOCK];
    for (uint k = 0; k < BLOCK; ++k) {
        base[k] = 0;
        last[k] = height - 1;
        total[k] = marginal_cdf[height - 1];
    }
    block_search(marginal_cdf, height, base, last, total, down, y);
    SCALAR_LOADS
    for (uint k = 0; k < BLOCK; ++k) {
        base[k] = y[k] * width;
        last[k] = width - 1;
        total[k] = row_cdf[base[k] + width - 1];
    }
    block_search(row_cdf, width, base, last, total, across, x);
#endif

    float f[BLOCK], sin_theta[BLOCK], cos_theta[BLOCK];
#if defined(PIXELS) && defined(GUIDED)
    for (uint k = 0; k < n; ++k)
        prefetch_line(radiance + (size_t)y[k] * width + x[k]);
    SCALAR_LOADS
    for (uint k = 0; k < n; ++k)
        f[k] = radiance[(size_t)y[k] * width + x[k]];
#else
    float red[BLOCK], green[BLOCK], blue[BLOCK];
    for (uint k = 0; k < n; ++k)
        prefetch_line(radiance + 3 * ((size_t)y[k] * width + x[k]));
    SCALAR_LOADS
    for (uint k = 0; k < n; ++k) {
        const float3 L = vload3((size_t)y[k] * width + x[k], radiance);
        red[k] = L.x;
        green[k] = L.y;
        blue[k] = L.z;
    }
    for (uint k = 0; k < n; ++k)
        f[k] = red[k] * scale + green[k] * scale + blue[k] * scale;
#endif
    float sin_phi[BLOCK], cos_phi[BLOCK];
    SCALAR_LOADS
    for (uint k = 0; k < n; ++k) {
        const float2 t = theta[y[k]];
        sin_theta[k] = t.x;
        cos_theta[k] = t.y;
#ifndef PIXELS
        const float2 p = phi[x[k]];
        sin_phi[k] = p.x;
        cos_phi[k] = p.y;
#endif
    }

    uint row[3 * BLOCK];
    for (uint k = 0; k < n; ++k) {
        row[2 * k] = x[k];
        row[2 * k + 1] = y[k];
    }
    stream_out(row, (global uint *)pixel + 2 * (size_t)begin, 2 * n);
    for (uint k = 0; k < n; ++k)
        row[k] = as_uint(f[k] * (sin_theta[k] * inverse_total));
    stream_out(row, (global uint *)probability + begin, n);
#ifndef PIXELS
    for (uint k = 0; k < n; ++k) {
        row[3 * k] = as_uint(sin_theta[k] * cos_phi[k]);
        row[3 * k + 1] = as_uint(cos_theta[k]);
        row[3 * k + 2] = as_uint(sin_theta[k] * sin_phi[k]);
    }
    stream_out(row, (global uint *)direction + 3 * (size_t)begin, 3 * n);
    for (uint k = 0; k < n; ++k) {
        row[3 * k] = as_uint(red[k]);
        row[3 * k + 1] = as_uint(green[k]);
        row[3 * k + 2] = as_uint(blue[k]);
    }
    stream_out(row, (global uint *)sample_radiance + 3 * (size_t)begin, 3 * n);
#endif
}
