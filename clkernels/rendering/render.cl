// Per-pixel Monte Carlo: the diffuse sphere with fresh samples for every pixel.
//
//     image(n) = integral of (albedo / pi) L(w) max(0, n . w) dw
//
// by one of three estimators, each unbiased. Let c = n . w, S = R + G + B, F the integral of S over the
// sphere of directions and k = pi / F. The densities are p_light = S / F and p_bsdf = c / pi, so with
// q = S k, pi p_light = q and pi p_bsdf = c; the image is albedo F / pi times the mean over samples of
//
// ESTIMATOR_LIGHT  w as the light      c L / S
// ESTIMATOR_BSDF   w as the cosine     L k
// ESTIMATOR_MIS    one of both         c L / S x q^2 / (q^2 + c^2)  and  L k x c^2 / (q^2 + c^2)
//
// (power heuristic: Veach 1997, 9.2.4; Pharr et al., 4th ed., 2.2.3). Terms of `light` and `mis` are at
// most 1, so nothing overflows whatever the range of the map. MIS compensation (Karlik et al. 2019) puts
// max(0, S - offset) in the place of S in the light's density, F with it; L is the map's as before.
//
// `light` looks at centres of pixels, as sample.cl does. The cosine's directions fall anywhere in a pixel,
// so `bsdf` and `mis` take the radiance for constant over a pixel, and `mis` places the light's samples
// evenly over its solid angle: theirs is the integral over areas (exact_areas.cl), that of `light` the sum over centres.
//
// edge   cos(theta) at the height + 1 borders of rows
// disc   pixels inside the disc, pixel_count of them
// sum    high words of resolution x resolution x 3, then low words: the samples so far; this adds samples begin .. end - 1
//
// One work-item BLOCK pixels, in short loops that compilers turn into vectors. Sample s of pixel i is point s of
// stream i, whatever ran before; the second point that `mis` needs is of stream 2^31 + i.

#include "rendering/pixel_block.clh"
#include "common/angle.clh"

typedef struct {
    guided_map map;
    global const float *radiance;
    global const float2 *theta;
    global const float2 *phi;
    global const float *edge;
    float scale;
    float offset;
    float k;
} Light;

#if defined(ESTIMATOR_LIGHT)

static inline void light_samples(const Light *light, private const block3 *n, private const uint *across,
                                 private const uint *down, private block_rgb *sum)
{
    uint x[BLOCK], y[BLOCK];
    pick_pixels(&light->map, across, down, BLOCK, x, y);
    float sin_theta[BLOCK], cos_theta[BLOCK], sin_phi[BLOCK], cos_phi[BLOCK];
    block_directions(light->theta, light->phi, x, y, sin_theta, cos_theta, sin_phi, cos_phi);
    float weight[BLOCK];
    for (uint k = 0; k < BLOCK; ++k) {
        const float cosine = sin_theta[k] * (n->x[k] * cos_phi[k] + n->z[k] * sin_phi[k]) + n->y[k] * cos_theta[k];
        weight[k] = fmax(cosine, 0.0f);
    }
    block_add_colours(sum, light->radiance, light->map.width, light->scale, x, y, weight);
}

#elif defined(ESTIMATOR_MIS)

// Where in its step of a CDF, from `below` to `above` and all of it `total`, each u lay, 0 to 1.
static inline void places(private const uint *u, private const uint *total, private const uint *below,
                          private const uint *above, private float *place)
{
    for (uint k = 0; k < BLOCK; ++k) {
        const ulong target = (ulong)u[k] * total[k];
        place[k] = ((float)((uint)(target >> 32) - below[k]) + (float)(uint)target * FRACTION) /
                   (float)(above[k] - below[k]);
    }
}

// c L / S_c with its weight q^2 / (q^2 + c^2) is L k / (q / c + c / q): no square that could leave the range.
static inline void light_samples(const Light *light, private const block3 *n, private const uint *across,
                                 private const uint *down, private block_rgb *sum)
{
    const guided_map *map = &light->map;
    uint x[BLOCK], y[BLOCK];
    pick_pixels(map, across, down, BLOCK, x, y);
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
        const wide S = radiance_sum(&L, k);
        const wide q = fmax(S - light->offset, (wide)(0.0f)) * light->k;
        const wide sum_of_ratios = q / cosine + cosine / q;
        STORE_WIDE(cosine > 0.0f && q > 0.0f ? light->k / sum_of_ratios : (wide)(0.0f), weight + k);
    }
    block_add(sum, &L, weight);
}

#endif

#if defined(ESTIMATOR_BSDF) || defined(ESTIMATOR_MIS)

// Malley's method: even over the disc, projected up to the hemisphere, in a frame about n (Duff et al. 2017).
// The radiance is that of the pixel that w lies in; an arc tangent keeps its digits at the poles, an arc cosine does not.
static inline void bsdf_samples(const Light *light, private const block3 *n, private const uint *u, private const uint *v,
                                private block_rgb *sum)
{
    const float width = light->map.width, height = light->map.height;
    uint x[BLOCK], y[BLOCK];
    float cosine[BLOCK];
    for (uint k = 0; k < BLOCK; k += WIDTH) {
        const wide r2 = wide_from_uint(LOAD_WIDE(u + k)) * FRACTION;
        const wide r = sqrt(r2), c = sqrt(1.0f - r2);
        wide sine, cosine_of_angle;
        sine_cosine(LOAD_WIDE(v + k), &sine, &cosine_of_angle);
        const wide p = r * cosine_of_angle, q = r * sine;
        const wide nx = LOAD_WIDE(n->x + k), ny = LOAD_WIDE(n->y + k), nz = LOAD_WIDE(n->z + k);
        const wide a = -1.0f / (1.0f + nz), b = nx * ny * a;
        const wide wx = p * (1.0f + nx * nx * a) + q * b + c * nx;
        const wide wy = p * b + q * (1.0f + ny * ny * a) + c * ny;
        const wide wz = c * nz - p * nx - q * ny;
        const wide theta = 2.0f * turns(sqrt(wx * wx + wz * wz), wy), phi = turns(wz, wx);
        const wide_uint row = wide_to_uint(theta * height), column = wide_to_uint((phi < 0.0f ? phi + 1.0f : phi) * width);
        STORE_WIDE(min(row, light->map.height - 1), y + k);
        STORE_WIDE(min(column, light->map.width - 1), x + k);
        STORE_WIDE(c, cosine + k);
    }
    block_rgb L;
    block_radiance(light->radiance, light->map.width, light->scale, x, y, &L);
    float weight[BLOCK];
    for (uint k = 0; k < BLOCK; k += WIDTH) {
#ifdef ESTIMATOR_MIS
        const wide S = radiance_sum(&L, k);
        const wide q = fmax(S - light->offset, (wide)(0.0f)) * light->k;
        const wide ratio = q / fmax(LOAD_WIDE(cosine + k), (wide)(FLT_MIN));
        STORE_WIDE(light->k / (1.0f + ratio * ratio), weight + k);
#else
        STORE_WIDE((wide)(light->k), weight + k);
#endif
    }
    block_add(sum, &L, weight);
}

#endif

kernel void render(global const float *restrict radiance,
#ifndef ESTIMATOR_BSDF
                   global const uint *restrict row_cdf,
                   global const uint *restrict marginal_cdf,
                   global const uint2 *restrict marginal_guide,
                   global const uint2 *restrict row_guide,
                   global const uint *restrict row_total,
                   const uint marginal_shift,
                   const uint row_shift,
                   global const float2 *restrict theta,
                   global const float2 *restrict phi,
                   global const float *restrict edge,
#endif
                   const uint width,
                   const uint height,
                   const float scale,
                   const float offset,
                   const float k_light,
                   global const uint2 *restrict disc,
                   const uint pixel_count,
                   const uint2 seed,
                   const uint begin,
                   const uint end,
                   const int resolution,
                   global float *restrict sum)
{
    const Light light = {
#ifdef ESTIMATOR_BSDF
        .map = {.width = width, .height = height},
#else
        .map = {row_cdf, marginal_cdf, marginal_guide, row_guide, row_total, marginal_shift, row_shift, width, height},
        .theta = theta,
        .phi = phi,
        .edge = edge,
#endif
        .radiance = radiance,
        .scale = scale,
        .offset = offset,
        .k = k_light,
    };

    const uint first = get_global_id(0) * BLOCK;
    uint index[BLOCK];
    block3 normal;
    block_pixels(disc, first, pixel_count, resolution, index, &normal);
    block_streams streams;
    begin_streams(&streams, index, begin, seed);
#ifdef ESTIMATOR_MIS
    uint second[BLOCK];
    for (uint k = 0; k < BLOCK; ++k)
        second[k] = index[k] | 0x80000000u;
    block_streams second_streams;
    begin_streams(&second_streams, second, begin, seed);
#endif

    block_rgb samples = {{{0.0f}}};
    for (uint s = begin; s < end; ++s) {
        uint u[BLOCK], v[BLOCK];
        next_points(&streams, s, seed, u, v);
#ifdef ESTIMATOR_BSDF
        bsdf_samples(&light, &normal, u, v, &samples);
#else
        light_samples(&light, &normal, u, v, &samples);
#endif
#ifdef ESTIMATOR_MIS
        next_points(&second_streams, s, seed, u, v);
        bsdf_samples(&light, &normal, u, v, &samples);
#endif
    }
    block_store(&samples, index, min((uint)BLOCK, pixel_count - first), resolution, sum);
}
