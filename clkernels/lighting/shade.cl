// A diffuse sphere lit by a set of directional lights, the same lights for every pixel.
//
//     image(n) = sum over lights of E max(0, n . w)
//
// lights  light_count x 6 floats: direction w, and E = albedo / pi x flux in red, green, blue; with GREY only 4 floats
//         each, as the channels are equal
//
// Other arguments: sphere.clh. One work-item per tile of WIDTH x ROWS pixels. Chunks of lights are summed in single
// precision, and the chunks' sums in double words, so that half a million lights lose no more digits than a hundred.

#include "common/double_word.clh"
#include "common/channels.clh"
#include "common/fma.clh"
#include "lighting/sphere.clh"

#define CHUNK 128  // lights

kernel void shade(global const uint2 *restrict tiles,
                  global const float *restrict lights,
                  const uint light_count,
                  const int resolution,
                  global float *restrict image)
{
    const uint2 tile = tiles[get_global_id(0)];
    wide nx, nz[ROWS];
    float ny[ROWS];
    wide_int c2[ROWS];
#pragma unroll
    for (int j = 0; j < ROWS; ++j)
        c2[j] = tile_normals(tile, j, resolution, &nx, ny + j, nz + j);

    wide sum[ROWS][CHANNELS], sum_lo[ROWS][CHANNELS];
#pragma unroll
    for (int j = 0; j < ROWS; ++j)
#pragma unroll
        for (int c = 0; c < CHANNELS; ++c)
            sum[j][c] = sum_lo[j][c] = 0.0f;

    for (uint first = 0; first < light_count; first += CHUNK) {
        const uint last = min(first + CHUNK, light_count);
        wide chunk[ROWS][CHANNELS];
#pragma unroll
        for (int j = 0; j < ROWS; ++j)
#pragma unroll
            for (int c = 0; c < CHANNELS; ++c)
                chunk[j][c] = 0.0f;

        for (uint i = first; i < last; ++i) {
            global const float *light = lights + (3 + CHANNELS) * (size_t)i;
            const wide x = nx * light[0];
#pragma unroll
            for (int j = 0; j < ROWS; ++j) {
                const wide cosine = fmax(FMA(nz[j], (wide)(light[2]), x + ny[j] * light[1]), (wide)(0.0f));
#pragma unroll
                for (int c = 0; c < CHANNELS; ++c)
                    chunk[j][c] = FMA(cosine, (wide)(light[3 + c]), chunk[j][c]);
            }
        }

#pragma unroll
        for (int j = 0; j < ROWS; ++j)
#pragma unroll
            for (int c = 0; c < CHANNELS; ++c)
                DOUBLE_WORD_ADD(wide, sum[j][c], sum_lo[j][c], chunk[j][c]);
    }

    for (int j = 0; j < ROWS; ++j)
        store_row(sum[j][RED], sum[j][GREEN], sum[j][BLUE], c2[j], tile, j, resolution, image);
}
