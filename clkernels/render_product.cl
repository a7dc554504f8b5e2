// Per-pixel Monte Carlo of the diffuse sphere, with light samples that know about the cosine.
//
//     image(n) = mean over samples of (albedo / pi) L(w) max(0, n . w) / pdf(w)
//              = mean of (L / S) (max(0, n . w) / C) x total x albedo / pi x solid angle / sin(theta)
//
// A tile of normals picks a cell of the map with probability proportional to flux(cell) C(tile, cell),
// and the cell picks a pixel by S sin(theta), S = R + G + B (product_cdf.cl, cells.cl); so the density is
// proportional to S C. L / S is at most 1 and the cosine at most 4 C: nothing overflows. Few directions
// below the horizon are drawn, and the noise of the cosine is gone but for the size of cells and tiles.
// (Two-stage importance sampling: Cline et al. 2006; product sampling: Clarberg et al. 2005.)
//
// sum            resolution x resolution double words of 3; this adds samples begin .. end - 1
// inverse_total  of S sin(theta) over the map, so that a tile's total leaves `sum` without the map's scale
//
// One work-item a pixel. Sample s of pixel i is point s of stream i, whatever ran before.

#include "double_word.clh"
#include "sequence.clh"
#include "invert_cdf.clh"
#include "normal.clh"
#include "product.clh"

kernel void render_product(global const uint *restrict tile_column_cdf,
                           global const uint *restrict tile_row_cdf,
                           global const float4 *restrict tiles,
                           global const float *restrict tile_total,
                           const uint tile_size,
                           const uint tiles_across,
                           global const uint *restrict column_cdf,
                           global const uint *restrict row_cdf,
                           global const float4 *restrict lights,
                           const uint2 cells,
                           const uint2 cell_size,
                           global const float *restrict radiance,
                           global const float2 *restrict theta,
                           global const float2 *restrict phi,
                           const uint width,
                           const uint height,
                           const float scale,
                           const float inverse_total,
                           global const uint2 *restrict disc,
                           const uint2 seed,
                           const uint begin,
                           const uint end,
                           const int resolution,
                           global float *restrict sum)
{
    const uint2 at = disc[get_global_id(0)];
    const uint index = at.y * resolution + at.x;
    const float3 normal = pixel_normal(at.x, at.y, resolution);
    const size_t t = (size_t)(at.y / tile_size) * tiles_across + at.x / tile_size;
    const float4 tile = tiles[t];
    const float total = tile_total[t];
    if (total == 0.0f)
        return;
    tile_row_cdf += t * cells.y;
    tile_column_cdf += t * cells.y * cells.x;

    float3 samples = 0.0f;
    for (uint s = begin; s < end; ++s) {
        const uint2 point = sequence_point(s, 0u, index, seed);
        uint across = point.x, down = point.y;
        const uint j = invert_cdf_rest(tile_row_cdf, cells.y, &down);
        const uint i = invert_cdf_rest(tile_column_cdf + j * cells.x, cells.x, &across);
        const uint2 first = (uint2)(i, j) * cell_size;
        const uint2 size = min(cell_size, (uint2)(width, height) - first);
        const uint y = first.y + invert_cdf(row_cdf + (size_t)i * height + first.y, size.y, down);
        const uint x = first.x + invert_cdf(column_cdf + (size_t)y * width + first.x, size.x, across);

        const float2 r = theta[y], p = phi[x];
        const float cosine = dot(normal, (float3)(r.x * p.y, r.y, r.x * p.x));
        if (cosine > 0.0f) {
            const float3 L = vload3((size_t)y * width + x, radiance) * scale;
            const float guess = product_cosine(tile, lights[j * cells.x + i]);
            samples += L * (cosine / guess / (L.x + L.y + L.z));
        }
    }
    samples *= total * inverse_total;
    float3 hi = vload3(2 * index, sum), lo = vload3(2 * index + 1, sum);
    DOUBLE_WORD_ADD(float3, hi, lo, samples);
    vstore3(hi, 2 * index, sum);
    vstore3(lo, 2 * index + 1, sum);
}
