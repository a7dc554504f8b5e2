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
// evenly over its solid angle: this integral is the sum over centres less about (pi / height)^2 / 8 of it.
//
// edge   cos(theta) at the height + 1 borders of rows
// sum    resolution x resolution double words of 3, the samples so far; this adds samples begin .. end - 1
//
// One work-item a pixel. Sample s of pixel i is point s of stream i, whatever ran before; the second
// point that `mis` needs is of stream 2^31 + i.

#include "double_word.clh"
#include "sequence.clh"
#include "invert_cdf.clh"
#include "normal.clh"
#include "angle.clh"

#define FRACTION 0x1p-32f

typedef struct {
    global const uint *row_cdf;
    global const uint *marginal_cdf;
    global const float *radiance;
    global const float2 *theta;
    global const float2 *phi;
    global const float *edge;
    uint width;
    uint height;
    float scale;
    float offset;
    float k;
} Light;

static inline float3 radiance_at(const Light *light, uint x, uint y)
{
    return vload3((size_t)y * light->width + x, light->radiance) * light->scale;
}

// q, pi times the light's density.
static inline float density(const Light *light, float3 L)
{
    return fmax(L.x + L.y + L.z - light->offset, 0.0f) * light->k;
}

#if defined(ESTIMATOR_LIGHT)

static inline float3 light_sample(const Light *light, float3 normal, uint2 u)
{
    const uint y = invert_cdf(light->marginal_cdf, light->height, u.y);
    const uint x = invert_cdf(light->row_cdf + (size_t)y * light->width, light->width, u.x);
    const float2 t = light->theta[y], p = light->phi[x];
    const float cosine = dot(normal, (float3)(t.x * p.y, t.y, t.x * p.x));
    if (cosine <= 0.0f)
        return (float3)(0.0f);
    const float3 L = radiance_at(light, x, y);
    return L * (cosine / (L.x + L.y + L.z));
}

#elif defined(ESTIMATOR_MIS)

// c L / S_c with its weight q^2 / (q^2 + c^2) is L k / (q / c + c / q): no square that could leave the range.
static inline float3 light_sample(const Light *light, float3 normal, uint2 u)
{
    uint across = u.x, down = u.y;
    const uint y = invert_cdf_rest(light->marginal_cdf, light->height, &down);
    const uint x = invert_cdf_rest(light->row_cdf + (size_t)y * light->width, light->width, &across);
    const float cos_theta = mix(light->edge[y], light->edge[y + 1], down * FRACTION);
    const float sin_theta = sqrt(fmax((1.0f - cos_theta) * (1.0f + cos_theta), 0.0f));
    const float2 p = sine_cosine((uint)((((ulong)x << 32) + across) / light->width));
    const float cosine = dot(normal, (float3)(sin_theta * p.y, cos_theta, sin_theta * p.x));
    const float3 L = radiance_at(light, x, y);
    const float q = density(light, L);
    if (cosine <= 0.0f || q <= 0.0f)
        return (float3)(0.0f);
    return L * (light->k / (q / cosine + cosine / q));
}

#endif

#if defined(ESTIMATOR_BSDF) || defined(ESTIMATOR_MIS)

// A vector given in a frame whose third axis is n, n.z >= 0 (Duff et al. 2017).
static inline float3 from_frame(float3 n, float3 v)
{
    const float a = -1.0f / (1.0f + n.z);
    const float b = n.x * n.y * a;
    return v.x * (float3)(1.0f + n.x * n.x * a, b, -n.x) + v.y * (float3)(b, 1.0f + n.y * n.y * a, -n.y) + v.z * n;
}

// The radiance of the pixel that w lies in; an arc tangent keeps its digits at the poles, an arc cosine does not.
static inline float3 radiance_towards(const Light *light, float3 w)
{
    const float v = 2.0f * turns(sqrt(w.x * w.x + w.z * w.z), w.y);
    const float u = turns(w.z, w.x);
    const uint y = min((uint)(v * light->height), light->height - 1);
    const uint x = min((uint)((u < 0.0f ? u + 1.0f : u) * light->width), light->width - 1);
    return radiance_at(light, x, y);
}

// Malley's method: even over the disc, projected up to the hemisphere.
static inline float3 bsdf_sample(const Light *light, float3 normal, uint2 u)
{
    const float r2 = u.x * FRACTION;
    const float r = sqrt(r2), cosine = sqrt(1.0f - r2);
    const float2 angle = sine_cosine(u.y);
    const float3 w = from_frame(normal, (float3)(r * angle.y, r * angle.x, cosine));
    const float3 L = radiance_towards(light, w);
#ifdef ESTIMATOR_MIS
    const float ratio = density(light, L) / fmax(cosine, FLT_MIN);
    return L * (light->k / (1.0f + ratio * ratio));
#else
    return L * light->k;
#endif
}

#endif

kernel void render(global const uint *restrict row_cdf,
                   global const uint *restrict marginal_cdf,
                   global const float *restrict radiance,
                   global const float2 *restrict theta,
                   global const float2 *restrict phi,
                   global const float *restrict edge,
                   const uint width,
                   const uint height,
                   const float scale,
                   const float offset,
                   const float k,
                   const uint2 seed,
                   const uint begin,
                   const uint end,
                   global const uint2 *restrict disc,
                   const int resolution,
                   global float *restrict sum)
{
    const Light light = {row_cdf, marginal_cdf, radiance, theta, phi, edge, width, height, scale, offset, k};
    const uint2 at = disc[get_global_id(0)];
    const uint index = at.y * resolution + at.x;
    const float3 normal = pixel_normal(at.x, at.y, resolution);

    float3 samples = 0.0f;
    for (uint s = begin; s < end; ++s) {
        const uint2 u = sequence_point(s, 0u, index, seed);
#if defined(ESTIMATOR_LIGHT)
        samples += light_sample(&light, normal, u);
#elif defined(ESTIMATOR_BSDF)
        samples += bsdf_sample(&light, normal, u);
#elif defined(ESTIMATOR_MIS)
        const uint2 second = sequence_point(s, 0u, index | 0x80000000u, seed);
        samples += light_sample(&light, normal, u) + bsdf_sample(&light, normal, second);
#endif
    }
    float3 hi = vload3(2 * index, sum), lo = vload3(2 * index + 1, sum);
    DOUBLE_WORD_ADD(float3, hi, lo, samples);
    vstore3(hi, 2 * index, sum);
    vstore3(lo, 2 * index + 1, sum);
}
