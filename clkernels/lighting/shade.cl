// A diffuse sphere lit by a set of directional lights, the same lights for every pixel.
//
//     image(n) = sum over lights of E max(0, n . w)
//
// tiles    (x, y) of each tile that meets the disc
// lights   light_count x 6 floats: direction w, and E = albedo / pi x flux in red, green, blue; or with GREY x 4, as the
//          three are the same
// image    resolution x resolution x 3, zeroed; pixels outside the disc are left alone
//
// One work-item a tile of PIXELS x ROWS pixels. Chunks of lights are summed in single precision, and the chunks' sums in
// double words, so that half a million lights lose no more digits than a hundred.

#include "common/double_word.clh"
#include "common/channels.clh"
#include "lighting/sphere.clh"

#define CHUNK 128  // lights

kernel void shade(global const uint2 *restrict tiles,
                  global const float *restrict lights,
                  const uint light_count,
                  const int resolution,
                  global float *restrict image)
{
    const uint2 tile = tiles[get_global_id(0)];
    const float inverse_resolution = 1.0f / resolution;

    // The tile's normals; ROWS rows share one n_x.
    const ipixels a = tile_a(tile, resolution);
    const pixels nx = pixels_from_int(a) * inverse_resolution;
    float ny[ROWS];
    pixels nz[ROWS];
    ipixels c2[ROWS];
#pragma unroll
    for (int j = 0; j < ROWS; ++j) {
        const int b = tile_b(tile, j, resolution);
        ny[j] = b * inverse_resolution;
        c2[j] = resolution * resolution - b * b - a * a;
        nz[j] = sqrt(fmax(pixels_from_int(c2[j]), (pixels)(0.0f))) * inverse_resolution;
    }

    pixels sum[ROWS][CHANNELS], sum_lo[ROWS][CHANNELS];
#pragma unroll
    for (int j = 0; j < ROWS; ++j)
#pragma unroll
        for (int c = 0; c < CHANNELS; ++c)
            sum[j][c] = sum_lo[j][c] = 0.0f;

    for (uint first = 0; first < light_count; first += CHUNK) {
        const uint last = min(first + CHUNK, light_count);
        pixels chunk[ROWS][CHANNELS];
#pragma unroll
        for (int j = 0; j < ROWS; ++j)
#pragma unroll
            for (int c = 0; c < CHANNELS; ++c)
                chunk[j][c] = 0.0f;

        for (uint i = first; i < last; ++i) {
            global const float *light = lights + (3 + CHANNELS) * (size_t)i;
            const pixels x = nx * light[0];
#pragma unroll
            for (int j = 0; j < ROWS; ++j) {
                const pixels cosine = fmax(FMA(nz[j], (pixels)(light[2]), x + ny[j] * light[1]), (pixels)(0.0f));
#pragma unroll
                for (int c = 0; c < CHANNELS; ++c)
                    chunk[j][c] = FMA(cosine, (pixels)(light[3 + c]), chunk[j][c]);
            }
        }

#pragma unroll
        for (int j = 0; j < ROWS; ++j)
#pragma unroll
            for (int c = 0; c < CHANNELS; ++c)
                DOUBLE_WORD_ADD(pixels, sum[j][c], sum_lo[j][c], chunk[j][c]);
    }

    for (int j = 0; j < ROWS; ++j) {
        float rgb[3][PIXELS];
        int inside[PIXELS];
        STORE_PIXELS(sum[j][RED], rgb[0]);
        STORE_PIXELS(sum[j][GREEN], rgb[1]);
        STORE_PIXELS(sum[j][BLUE], rgb[2]);
        STORE_PIXELS(c2[j], inside);
        for (int k = 0; k < PIXELS; ++k)
            if (inside[k] > 0)
                vstore3((float3)(rgb[0][k], rgb[1][k], rgb[2][k]),
                        (tile.y + j) * (size_t)resolution + tile.x + k, image);
    }
}
