// Fourier sums along the rows of an environment map: the first half of a projection onto spherical harmonics.
//
//     sum(y, m) = sum over x of scale L(x, y) (cos(m phi_x), sin(m phi_x)), for R, G and B
//
// radiance      height x width x 3 floats
// cosine, sine  orders x width floats: cos(m phi_x) and sin(m phi_x)
// scale         a power of two that keeps sums inside float's range
// sum           height x orders x 6 floats: R, G, B with the cosine, then with the sine
//
// One work-item per (m, y), 16 pixels at a time. Chunks of pixels are summed in single precision, and the chunks' sums
// in double words.

#include "common/double_word.clh"
#include "common/lanes.clh"
#include "common/map_row.clh"

#define CHUNK 256  // pixels, a multiple of LANES

kernel void azimuth_sums(global const float *restrict radiance,
                         global const float *restrict cosine,
                         global const float *restrict sine,
                         const uint width,
                         const float scale,
                         global float *restrict sum)
{
    const uint m = get_global_id(0), orders = get_global_size(0);
    const size_t y = get_global_id(1);
    radiance += y * width * 3;
    cosine += (size_t)m * width;
    sine += (size_t)m * width;

    float8 hi = 0.0f, lo = 0.0f;
    const uint whole = width - width % LANES;
    for (uint first = 0; first < whole; first += CHUNK) {
        const uint last = min(first + CHUNK, whole);
        float16 red_c = 0.0f, green_c = 0.0f, blue_c = 0.0f, red_s = 0.0f, green_s = 0.0f, blue_s = 0.0f;
        for (uint x = first; x < last; x += LANES) {
            float16 red, green, blue;
            load_rgb(radiance + 3 * (size_t)x, &red, &green, &blue);
            const float16 c = vload16(0, cosine + x) * scale, s = vload16(0, sine + x) * scale;
            red_c += red * c;
            green_c += green * c;
            blue_c += blue * c;
            red_s += red * s;
            green_s += green * s;
            blue_s += blue * s;
        }
        const float8 chunk = (float8)(sum_of_lanes(red_c), sum_of_lanes(green_c), sum_of_lanes(blue_c),
                                      sum_of_lanes(red_s), sum_of_lanes(green_s), sum_of_lanes(blue_s), 0.0f, 0.0f);
        DOUBLE_WORD_ADD(float8, hi, lo, chunk);
    }
    for (uint x = whole; x < width; ++x) {
        const float3 L = vload3(x, radiance);
        const float c = cosine[x] * scale, s = sine[x] * scale;
        const float8 term = (float8)(L.x * c, L.y * c, L.z * c, L.x * s, L.y * s, L.z * s, 0.0f, 0.0f);
        DOUBLE_WORD_ADD(float8, hi, lo, term);
    }

    vstore3(hi.s012, 2 * (y * orders + m), sum);
    vstore3(hi.s345, 2 * (y * orders + m) + 1, sum);
}
