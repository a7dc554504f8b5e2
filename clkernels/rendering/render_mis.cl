// Per-pixel Monte Carlo of the diffuse sphere: directions sampled by the light and by the cosine, all weighted.
//
// Of the 2 spp directions of a pixel, the light samples n_light and the cosine n_cosine, at least one each. Their
// densities are p_light = S / F and p_bsdf = c / pi. With
//
//     q = S x pi / F x n_light / n_cosine,    k = pi / F x spp / n_cosine
//
// n_light p_light is to n_cosine p_bsdf as q to c. By the balance heuristic (Veach 1997, 9.2.2; Pharr et al., 4th ed.,
// 2.2.3) the image is albedo F / pi times the sum over all directions, whichever sampled them, divided by spp, of
//
//     L k c / (q + c)
//
// MIS compensation (Karlik et al. 2019) puts max(0, S - offset) in place of S in q, and its integral in place of F; L
// stays the map's. Without compensation no term is above spp / n_light, so nothing overflows whatever the range of the
// map. With it, q = 0 where S <= offset, and the term is L k, which is at most offset k.
//
// The cosine's directions fall anywhere in a pixel, whose radiance is constant over its area. The light's directions
// are uniform over its solid angle. So this converges to the integral over areas (exact_areas.cl).
//
// Arguments are those of pixel_block.clh, and
//
// row_cdf, marginal_cdf, strips
//                        of S - offset
// edge                   cos(theta) at the height + 1 borders of rows
// offset                 in units of the scaled map
// spp, n_light           see above; a launch adds the parts of the light's and of the cosine's samples from begin to end
// seed                   pixel i's light samples take points of stream i, its cosine samples those of stream 2^31 + i
//
// One work-item per BLOCK pixels.

#include "rendering/cosine_block.clh"
#include "rendering/pixel_places.clh"

typedef struct {
    guided_map map;
    global const float *radiance;
    global const float *edge;
    float scale;
    float offset;
    float density;
    float k;
} light_map;

// Add the terms of directions in the pixels (x, y) of the map.
static inline void add_terms(const light_map *light, private const uint *x, private const uint *y,
                             private const float *cosine, private block_rgb *sum)
{
    block_rgb L;
    block_radiance(light->radiance, light->map.width, light->scale, x, y, &L);
    float weight[BLOCK];
    for (uint k = 0; k < BLOCK; k += WIDTH) {
        const wide q = fmax(radiance_sum(&L, k) - light->offset, (wide)(0.0f)) * light->density;
        const wide c = LOAD_WIDE(cosine + k);
        STORE_WIDE(light->k * c / fmax(q + c, (wide)(FLT_MIN)), weight + k);
    }
    block_add(sum, &L, weight);
}

static inline void add_light_samples(const light_map *light, private const block3 *n, private const uint *across,
                                     private const uint *down, private block_rgb *sum)
{
    uint x[BLOCK], y[BLOCK];
    block_directions w;
    float cosine[BLOCK];
    pick_directions(&light->map, light->edge, across, down, x, y, &w);
    block_cosines(n, &w, cosine);
    add_terms(light, x, y, cosine, sum);
}

static inline void add_cosine_samples(const light_map *light, private const block3 *n, private const uint *across,
                                      private const uint *down, private block_rgb *sum)
{
    uint x[BLOCK], y[BLOCK];
    float cosine[BLOCK];
    block_cosine_pixels(n, across, down, light->map.width, light->map.height, x, y, cosine);
    add_terms(light, x, y, cosine, sum);
}

// How many of `count` samples belong to the first `done` of `spp`.
static inline uint samples_until(uint done, uint count, uint spp)
{
    return (uint)((ulong)done * count / spp);
}

kernel void render_mis(global const float *restrict radiance,
                       global const uint *restrict row_cdf,
                       global const uint *restrict marginal_cdf,
                       global const uint4 *restrict strips,
                       const uint strip_bits,
                       global const uint2 *restrict marginal_guide,
                       global const uint2 *restrict row_guide,
                       global const uint *restrict row_total,
                       const uint marginal_shift,
                       const uint row_shift,
                       global const float *restrict edge,
                       const uint width,
                       const uint height,
                       const float scale,
                       const float offset,
                       const float k,
                       global const uint2 *restrict disc,
                       const uint pixel_count,
                       const uint2 seed,
                       const uint begin,
                       const uint end,
                       const uint spp,
                       const uint n_light,
                       const int resolution,
                       global float *restrict sum)
{
    const uint n_cosine = 2 * spp - n_light;
    const light_map light = {
        .map = {strips, row_cdf, marginal_cdf, marginal_guide, row_guide, row_total, strip_bits, marginal_shift,
                row_shift, width, height},
        .radiance = radiance,
        .edge = edge,
        .scale = scale,
        .offset = offset,
        .density = k * ((float)n_light / (float)n_cosine),
        .k = k * ((float)spp / (float)n_cosine),
    };
    pixel_block block;
    uint s = samples_until(begin, n_light, spp);
    begin_block(&block, disc, pixel_count, s, seed, resolution);
    for (const uint last = samples_until(end, n_light, spp); s < last; ++s) {
        uint across[BLOCK], down[BLOCK];
        next_points(&block.streams, s, across, down);
        add_light_samples(&light, &block.normal, across, down, &block.samples);
    }

    uint second[BLOCK];
    for (uint i = 0; i < BLOCK; ++i)
        second[i] = block.index[i] | 0x80000000u;
    s = samples_until(begin, n_cosine, spp);
    begin_streams(&block.streams, second, s, seed);
    for (const uint last = samples_until(end, n_cosine, spp); s < last; ++s) {
        uint across[BLOCK], down[BLOCK];
        next_points(&block.streams, s, across, down);
        add_cosine_samples(&light, &block.normal, across, down, &block.samples);
    }
    end_block(&block, pixel_count, resolution, sum);
}
