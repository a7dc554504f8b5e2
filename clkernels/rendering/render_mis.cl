// Per-pixel Monte Carlo of the diffuse sphere: one direction sampled by the light and one by the cosine, both weighted.
//
// The densities are p_light = S / F and p_bsdf = c / pi; with q = S k, pi p_light = q and pi p_bsdf = c. By the power
// heuristic (Veach 1997, 9.2.4; Pharr et al., 4th ed., 2.2.3) the image is albedo F / pi times the mean over samples of
//
//     c L / S x q^2 / (q^2 + c^2)        of the direction sampled by the light
//         L k x c^2 / (q^2 + c^2)        of the direction sampled by the cosine
//
// No term is above 1, so nothing overflows whatever the range of the map. MIS compensation (Karlik et al. 2019) puts
// max(0, S - offset) in place of S in the light's density, and its integral in place of F; L stays the map's.
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
    float k;
} light_map;

// q of a pixel of the map.
static inline wide light_density(const light_map *light, private const block_rgb *L, uint k)
{
    return fmax(radiance_sum(L, k) - light->offset, (wide)(0.0f)) * light->k;
}

// c L / S with its weight q^2 / (q^2 + c^2) is L k / (q / c + c / q): no square that could leave float's range.
static inline void add_light_samples(const light_map *light, private const block3 *n, private const uint *across,
                                     private const uint *down, private block_rgb *sum)
{
    // A pixel of the map, sampled by its light, and a direction in it
    uint x[BLOCK], y[BLOCK];
    block_directions w;
    pick_directions(&light->map, light->edge, across, down, x, y, &w);

    // L k / (q / c + c / q)
    block_rgb L;
    block_radiance(light->radiance, light->map.width, light->scale, x, y, &L);
    float cosine[BLOCK], weight[BLOCK];
    block_cosines(n, &w, cosine);
    for (uint k = 0; k < BLOCK; k += WIDTH) {
        const wide q = light_density(light, &L, k), c = LOAD_WIDE(cosine + k);
        STORE_WIDE(c > 0.0f && q > 0.0f ? light->k / (q / c + c / q) : (wide)(0.0f), weight + k);
    }
    block_add(sum, &L, weight);
}

// L k with its weight c^2 / (q^2 + c^2) is L k / (1 + (q / c)^2).
static inline void add_cosine_samples(const light_map *light, private const block3 *n, private const uint *across,
                                      private const uint *down, private block_rgb *sum)
{
    // The pixel of the map in which a direction sampled by the cosine lies
    uint x[BLOCK], y[BLOCK];
    float cosine[BLOCK], weight[BLOCK];
    block_cosine_pixels(n, across, down, light->map.width, light->map.height, x, y, cosine);

    // L k / (1 + (q / c)^2)
    block_rgb L;
    block_radiance(light->radiance, light->map.width, light->scale, x, y, &L);
    for (uint k = 0; k < BLOCK; k += WIDTH) {
        const wide ratio = light_density(light, &L, k) / fmax(LOAD_WIDE(cosine + k), (wide)(FLT_MIN));
        STORE_WIDE(light->k / (1.0f + ratio * ratio), weight + k);
    }
    block_add(sum, &L, weight);
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
                       const int resolution,
                       global float *restrict sum)
{
    const light_map light = {
        .map = {strips, row_cdf, marginal_cdf, marginal_guide, row_guide, row_total, strip_bits, marginal_shift,
                row_shift, width, height},
        .radiance = radiance,
        .edge = edge,
        .scale = scale,
        .offset = offset,
        .k = k,
    };
    pixel_block block;
    begin_block(&block, disc, pixel_count, begin, seed, resolution);
    uint second[BLOCK];
    for (uint i = 0; i < BLOCK; ++i)
        second[i] = block.index[i] | 0x80000000u;
    block_streams cosine_streams;
    begin_streams(&cosine_streams, second, begin, seed);

    for (uint s = begin; s < end; ++s) {
        uint across[BLOCK], down[BLOCK];
        next_points(&block.streams, s, across, down);
        add_light_samples(&light, &block.normal, across, down, &block.samples);
        next_points(&cosine_streams, s, across, down);
        add_cosine_samples(&light, &block.normal, across, down, &block.samples);
    }
    end_block(&block, pixel_count, resolution, sum);
}
