// A diffuse sphere lit by a set of directional lights on a GPU: the image of shade.cl up to rounding.
//
//     image(n) = sum over lights of E max(0, n . w)
//
// ACROSS x DOWN work-items form a patch that covers the tile; each of them computes PIXELS pixels of one column. They
// all read the same light at the same time, and use it for all of their pixels. The group has SLICES patches, which
// share out the lights. At the end the patches' sums are added, always in the same order.
//
// tiles   the first pixel (i, j) of each tile that meets the disc, ACROSS x (DOWN PIXELS) pixels
// lights  light_count x 8 floats: direction w and 0, E and 0; with GREY 4 floats: w, E
//
// Other arguments: shade.cl. One group of GROUP work-items per tile.

#include "common/channels.clh"
#include "common/double_word.clh"
#include "common/fma.clh"
#include "common/normal.clh"

#define PIXELS 8
#define CHUNK 1024  // lights that a group holds in local memory
#define ACROSS 8
#define DOWN 4
#define PATCH (ACROSS * DOWN)
#define SLICES (GROUP / PATCH)

#ifdef GREY
#define VECTORS 1  // per light
#else
#define VECTORS 2
#endif
#define SUMS (PIXELS / 2 * CHANNELS * GROUP / 2)
#define SHARED (CHUNK * VECTORS > SUMS ? CHUNK * VECTORS : SUMS)

__attribute__((reqd_work_group_size(GROUP, 1, 1)))
kernel void shade_grouped(global const uint2 *restrict tiles,
                          global const float4 *restrict lights,
                          const uint light_count,
                          const int resolution,
                          global float *restrict image)
{
    local float4 shared[SHARED];
    const uint i = get_local_id(0), lane = i % PATCH, slice = i / PATCH;
    const uint2 tile = tiles[get_global_id(0) / GROUP];
    const int x = tile.x + lane % ACROSS, y = tile.y + lane / ACROSS;
    const float nx = pixel_normal(x, y, resolution).x;
    float ny[PIXELS], nz[PIXELS], hi[PIXELS][CHANNELS], lo[PIXELS][CHANNELS];
#pragma unroll
    for (int j = 0; j < PIXELS; ++j) {
        const float3 n = pixel_normal(x, y + DOWN * j, resolution);
        ny[j] = n.y;
        nz[j] = n.z;
#pragma unroll
        for (int c = 0; c < CHANNELS; ++c)
            hi[j][c] = lo[j][c] = 0.0f;
    }

    for (uint first = 0; first < light_count; first += CHUNK) {
        const uint count = min((uint)CHUNK, light_count - first);
        barrier(CLK_LOCAL_MEM_FENCE);
        for (uint k = i; k < count * VECTORS; k += GROUP)
            shared[k] = lights[(size_t)first * VECTORS + k];
        barrier(CLK_LOCAL_MEM_FENCE);
        float chunk[PIXELS][CHANNELS];
#pragma unroll
        for (int j = 0; j < PIXELS; ++j)
#pragma unroll
            for (int c = 0; c < CHANNELS; ++c)
                chunk[j][c] = 0.0f;

#pragma unroll 2
        for (uint k = slice; k < count; k += SLICES) {
            const float4 w = shared[VECTORS * k];
#ifdef GREY
            const float E[1] = {w.w};
#else
            const float4 of_light = shared[VECTORS * k + 1];
            const float E[3] = {of_light.x, of_light.y, of_light.z};
#endif
            const float along = nx * w.x;
#pragma unroll
            for (int j = 0; j < PIXELS; ++j) {
                const float cosine = fmax(FMA(nz[j], w.z, FMA(ny[j], w.y, along)), 0.0f);
#pragma unroll
                for (int c = 0; c < CHANNELS; ++c)
                    chunk[j][c] = FMA(cosine, E[c], chunk[j][c]);
            }
        }

#pragma unroll
        for (int j = 0; j < PIXELS; ++j)
#pragma unroll
            for (int c = 0; c < CHANNELS; ++c)
                DOUBLE_WORD_ADD(float, hi[j][c], lo[j][c], chunk[j][c]);
    }

    // Add the patches' sums, for half of the pixels at a time: local memory has no room for all.
    local float2 *parts = (local float2 *)shared;  // by pixel and channel, then by work-item
#pragma unroll
    for (int half_of = 0; half_of < 2; ++half_of) {
        barrier(CLK_LOCAL_MEM_FENCE);
#pragma unroll
        for (int j = 0; j < PIXELS / 2; ++j)
#pragma unroll
            for (int c = 0; c < CHANNELS; ++c)
                parts[(j * CHANNELS + c) * GROUP + i] =
                    (float2)(hi[half_of * PIXELS / 2 + j][c], lo[half_of * PIXELS / 2 + j][c]);
        barrier(CLK_LOCAL_MEM_FENCE);
        for (uint k = slice; k < PIXELS / 2 * CHANNELS; k += SLICES) {
            const int below = y + DOWN * (half_of * PIXELS / 2 + (int)(k / CHANNELS));
            if (pixel_normal(x, below, resolution).z <= 0.0f)
                continue;
            float2 sum = parts[k * GROUP + lane];
            for (uint from = 1; from < SLICES; ++from)
                sum = double_word_sum(sum, parts[k * GROUP + from * PATCH + lane]);
            global float *pixel = image + 3 * (below * (size_t)resolution + x);
#ifdef GREY
            pixel[0] = pixel[1] = pixel[2] = sum.x;
#else
            pixel[k % CHANNELS] = sum.x;
#endif
        }
    }
}
