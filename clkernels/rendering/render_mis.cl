// Per-pixel Monte Carlo of the diffuse sphere: a direction drawn as the light is and one drawn as the cosine, weighted.
//
// The densities are p_light = S / F and p_bsdf = c / pi; with q = S k, pi p_light = q and pi p_bsdf = c. By the power
// heuristic (Veach 1997, 9.2.4; Pharr et al., 4th ed., 2.2.3) the image is albedo F / pi times the mean over samples of
//
//     c L / S x q^2 / (q^2 + c^2)        of the direction drawn as the light
//         L k x c^2 / (q^2 + c^2)        of the direction drawn as the cosine
//
// No term is above 1, so nothing overflows whatever the range of the map. MIS compensation (Karlik et al. 2019) puts
// max(0, S - offset) in the place of S in the light's density, F with it; L is the map's as before.
//
// The cosine's directions fall anywhere in a pixel, so the radiance is constant over a pixel, and the light's directions
// are placed evenly over its solid angle: this converges to the integral over areas (exact_areas.cl).
//
// Arguments are those of pixel_block.clh, k, and
//
// row_cdf, marginal_cdf  of S - offset
// edge                   cos(theta) at the height + 1 borders of rows
// offset                 of the scaled map
// seed                   the cosine takes points of stream 2^31 + i, where the light takes them of stream i
//
// One work-item BLOCK pixels.

#include "common/guided.clh"
#include "rendering/cosine_block.clh"

typedef struct {
    guided_map map;
    global const float *radiance;
    global const float *edge;
    float scale;
    float offset;
    float k;
} Light;

// q of a pixel of the map.
static inline wide light_density(const Light *light, private const block_rgb *L, uint k)
{
    return fmax(radiance_sum(L, k) - light->offset, (wide)(0.0f)) * light->k;
}

// Where in the step of a CDF that it picks, from `below` to `above` of `total`, each u lies: from 0 to 1.
static inline void places(private const uint *u, private const uint *total, private const uint *below,
                          private const uint *above, private float *place)
{
    for (uint k = 0; k < BLOCK; ++k) {
        const ulong target = (ulong)u[k] * total[k];
        place[k] = ((float)((uint)(target >> 32) - below[k]) + (float)(uint)target * FRACTION) /
                   (float)(above[k] - below[k]);
    }
}

// c L / S with its weight q^2 / (q^2 + c^2) is L k / (q / c + c / q): no square that could leave float's range.
static inline void add_light_samples(const Light *light, private const block3 *n, private const uint *across,
                                     private const uint *down, private block_rgb *sum)
{
    // A pixel of the map, drawn as its light
    const guided_map *map = &light->map;
    uint x[BLOCK], y[BLOCK];
    pick_pixels(map, across, down, BLOCK, x, y);

    // A direction in it, even over its solid angle: the points' places in the steps that they picked are even again
    uint total[BLOCK], below[BLOCK], above[BLOCK];
    float place[BLOCK], cos_theta[BLOCK], turn[BLOCK];
    SCALAR_LOADS
    for (uint k = 0; k < BLOCK; ++k) {
        global const uint *at = map->marginal_cdf + y[k];
        total[k] = map->marginal_cdf[map->height - 1];
        below[k] = y[k] == 0 ? 0 : at[-1];
        above[k] = at[0];
    }
    places(down, total, below, above, place);
    SCALAR_LOADS
    for (uint k = 0; k < BLOCK; ++k)
        cos_theta[k] = mix(light->edge[y[k]], light->edge[y[k] + 1], place[k]);
    SCALAR_LOADS
    for (uint k = 0; k < BLOCK; ++k) {
        global const uint *at = map->row_cdf + (size_t)y[k] * map->width + x[k];
        total[k] = map->row_total[y[k]];
        below[k] = x[k] == 0 ? 0 : at[-1];
        above[k] = at[0];
    }
    places(across, total, below, above, place);
    for (uint k = 0; k < BLOCK; ++k)
        turn[k] = x[k] + place[k];

    // L k / (q / c + c / q)
    block_rgb L;
    block_radiance(light->radiance, light->map.width, light->scale, x, y, &L);
    const float turns_a_column = 1.0f / map->width;
    float weight[BLOCK];
    for (uint k = 0; k < BLOCK; k += WIDTH) {
        const wide cos_theta_k = LOAD_WIDE(cos_theta + k);
        const wide sin_theta = sqrt(fmax((1.0f - cos_theta_k) * (1.0f + cos_theta_k), (wide)(0.0f)));
        wide sin_phi, cos_phi;
        sine_cosine_of_turns(LOAD_WIDE(turn + k) * turns_a_column, &sin_phi, &cos_phi);
        const wide cosine = sin_theta * (LOAD_WIDE(n->x + k) * cos_phi + LOAD_WIDE(n->z + k) * sin_phi)
                          + LOAD_WIDE(n->y + k) * cos_theta_k;
        const wide q = light_density(light, &L, k);
        const wide sum_of_ratios = q / cosine + cosine / q;
        STORE_WIDE(cosine > 0.0f && q > 0.0f ? light->k / sum_of_ratios : (wide)(0.0f), weight + k);
    }
    block_add(sum, &L, weight);
}

// L k with its weight c^2 / (q^2 + c^2) is L k / (1 + (q / c)^2).
static inline void add_cosine_samples(const Light *light, private const block3 *n, private const uint *across,
                                      private const uint *down, private block_rgb *sum)
{
    // The pixel of the map that a direction lies in, drawn as the cosine
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
    const Light light = {
        .map = {row_cdf, marginal_cdf, marginal_guide, row_guide, row_total, marginal_shift, row_shift, width, height},
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
