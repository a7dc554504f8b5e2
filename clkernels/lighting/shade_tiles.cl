// A diffuse sphere lit by directional lights, without evaluating most pairs of a pixel and a light.
//
//     image(n) = sum over lights of E max(0, n . w) = n . M + sum over lights near the horizon
//
// The cosine is linear above the horizon. The normals of a tile lie within `margin` of its axis, so a light with
// axis . w >= margin lights all of the tile unclamped, and one with axis . w <= -margin lights none of it. The
// unclamped ones need no work per pixel: their sum is n . M with the 3 x 3 matrix M = sum of w E^T (Arvo's vector
// irradiance, 1994). Only lights near the tile's horizon are evaluated pixel by pixel. The image is that of shade.cl up
// to rounding. Lights are sorted, so that the 16 of a group lie close together: most groups light all of the tile or
// none of it, and then only the group's bounds and matrix are read.
//
// lights          6 rows of stride floats: w_x, w_y, w_z, and E = albedo / pi x flux in red, green, blue; with GREY 4
//                 rows, as the channels are equal. stride is a multiple of 16, and E beyond the last light is 0
// bounds, groups  of groups of 16 lights, see light_groups.cl
//
// Other arguments: sphere.clh. One work-item per tile of 16 x ROWS pixels (ROWS even): it classifies and sums 16 lights
// at a time, and evaluates 16 pixels at a time.

#include "common/channels.clh"
#include "common/double_word.clh"
#include "common/fma.clh"
#include "common/lanes.clh"

#define WIDTH LANES
#include "lighting/sphere.clh"

#define CHUNK 1024  // lights that are summed in single precision; the chunks' sums go into double words
#define LIST 128    // lights near the horizon, evaluated when the list is full

typedef struct {
    float16 hi, lo;
} double_word16;

static inline float max16(float16 v)
{
    const float8 e = fmax(v.lo, v.hi);
    const float4 q = fmax(e.lo, e.hi);
    const float2 p = fmax(q.lo, q.hi);
    return fmax(p.x, p.y);
}

static inline void add_to(private double_word16 *sum, float16 x)
{
    DOUBLE_WORD_ADD(float16, sum->hi, sum->lo, x);
}

// Append to the list of n lights each of `first` .. first + 15 whose lane is true, and return the list's new length.
// There is no branch: every light is written, and one that does not belong is overwritten by the next.
static inline uint append(private uint *list, uint n, uint first, int16 belongs)
{
    int is_one_more[LANES];
    vstore16(belongs & 1, 0, is_one_more);  // true is -1 in a vector
    for (uint k = 0; k < LANES; ++k) {
        list[n] = first + k;
        n += is_one_more[k];
    }
    return n;
}

// What the listed lights send to two rows of the tile, pixel by pixel: the channels of the first, then of the second.
static inline void evaluate(private const uint *list, uint n, global const float *lights, size_t stride,
                            float16 nx, private const float *ny, private const float16 *nz, private float16 *sent)
{
    float16 above[CHANNELS], below[CHANNELS];
#pragma unroll
    for (int c = 0; c < CHANNELS; ++c)
        above[c] = below[c] = 0.0f;
    for (uint i = 0; i < n; ++i) {
        global const float *light = lights + list[i];
        const float16 x = nx * light[0];
        const float wy = light[stride];
        const float16 wz = light[2 * stride];
        const float16 c0 = fmax(FMA(nz[0], wz, x + ny[0] * wy), (float16)(0.0f));
        const float16 c1 = fmax(FMA(nz[1], wz, x + ny[1] * wy), (float16)(0.0f));
#pragma unroll
        for (int c = 0; c < CHANNELS; ++c) {
            const float16 E = light[(3 + c) * stride];
            above[c] = FMA(c0, E, above[c]);
            below[c] = FMA(c1, E, below[c]);
        }
    }
#pragma unroll
    for (int c = 0; c < CHANNELS; ++c) {
        sent[c] = above[c];
        sent[CHANNELS + c] = below[c];
    }
}

kernel void shade_tiles(global const uint2 *restrict tiles,
                        global const float *restrict lights,
                        const uint stride,
                        global const float4 *restrict bounds,
                        global const float *restrict groups,
                        const int resolution,
                        global float *restrict image)
{
    const uint2 tile = tiles[get_global_id(0)];

    // The tile's normals, and their mean as its axis
    float16 nx, nz[ROWS];
    float ny[ROWS];
    int16 c2[ROWS];
    float16 mean_x = 0.0f, mean_y = 0.0f, mean_z = 0.0f;
    for (int j = 0; j < ROWS; ++j) {
        c2[j] = tile_normals(tile, j, resolution, &nx, ny + j, nz + j);
        const float16 inside = select((float16)(0.0f), (float16)(1.0f), c2[j] > 0);
        mean_x += inside * nx;
        mean_y += inside * ny[j];
        mean_z += inside * nz[j];
    }
    const float3 axis = normalize((float3)(sum_of_lanes(mean_x), sum_of_lanes(mean_y), sum_of_lanes(mean_z)));
    float16 chord2 = 0.0f;
    for (int j = 0; j < ROWS; ++j) {
        const float16 x = nx - axis.x, z = nz[j] - axis.z;
        const float y = ny[j] - axis.y;
        chord2 = select(chord2, fmax(chord2, x * x + y * y + z * z), c2[j] > 0);
    }
    // |n . w - axis . w| <= |n - axis|; the rest allows for rounding.
    const float margin = sqrt(max16(chord2)) * 1.00001f + 1e-6f;

    // Lights near the horizon wait in a list. When it is full, they are spilled: evaluated, and summed per pixel.
    uint list[LIST + LANES];
    uint n = 0;
    bool spilled = false;
    double_word16 sum[ROWS * CHANNELS];

    // M of the lights that light the whole tile: one sum for whole groups, and for single lights one per channel, axis
    // and lane.
    double_word16 group_matrix, matrix[3 * CHANNELS];
    group_matrix.hi = group_matrix.lo = 0.0f;
    for (int k = 0; k < 3 * CHANNELS; ++k)
        matrix[k].hi = matrix[k].lo = 0.0f;

    for (uint begin = 0; begin < stride; begin += CHUNK) {
        const uint end = min(begin + CHUNK, stride);
        float16 group_chunk = 0.0f, chunk[3 * CHANNELS];
#pragma unroll
        for (int k = 0; k < 3 * CHANNELS; ++k)
            chunk[k] = 0.0f;
        for (uint i = begin; i < end; i += LANES) {
            // A group that is clear of the tile's horizon lights none of the tile, or all of it.
            const float4 bound = bounds[i / LANES];
            const float above = axis.x * bound.x + axis.y * bound.y + axis.z * bound.z, reach = margin + bound.w;
            if (above <= -reach)
                continue;
            if (above >= reach) {
                group_chunk += vload16(i / LANES, groups);
                continue;
            }

            // Of any other group, lights clear of the horizon go into the matrix as w E^T, with E = 0 for those below.
            global const float *light = lights + i;
            const float16 wx = vload16(0, light), wy = vload16(0, light + stride);
            const float16 wz = vload16(0, light + 2 * (size_t)stride);
            const float16 cosine = FMA(wz, (float16)(axis.z), FMA(wy, (float16)(axis.y), wx * axis.x));
            const float16 zero = 0.0f;
#pragma unroll
            for (int c = 0; c < CHANNELS; ++c) {
                const float16 E = select(zero, vload16(0, light + (3 + c) * (size_t)stride), cosine >= margin);
                chunk[3 * c] = FMA(wx, E, chunk[3 * c]);
                chunk[3 * c + 1] = FMA(wy, E, chunk[3 * c + 1]);
                chunk[3 * c + 2] = FMA(wz, E, chunk[3 * c + 2]);
            }

            // Lights near the horizon go into the list.
            n = append(list, n, i, fabs(cosine) < margin);
            if (n >= LIST) {
                for (int k = 0; !spilled && k < ROWS * CHANNELS; ++k)
                    sum[k].hi = sum[k].lo = 0.0f;
                spilled = true;
                for (int j = 0; j < ROWS; j += 2) {
                    float16 sent[2 * CHANNELS];
                    evaluate(list, n, lights, stride, nx, ny + j, nz + j, sent);
                    for (int k = 0; k < 2 * CHANNELS; ++k)
                        add_to(sum + CHANNELS * j + k, sent[k]);
                }
                n = 0;
            }
        }
        add_to(&group_matrix, group_chunk);
#pragma unroll
        for (int k = 0; k < 3 * CHANNELS; ++k)
            add_to(matrix + k, chunk[k]);
    }

    // Each pixel is n . M, plus the lights still in the list, plus those that were spilled.
    const float16 g = group_matrix.hi + group_matrix.lo;
    const float of_groups[9] = {g.s0, g.s4, g.s8, g.s1, g.s5, g.s9, g.s2, g.s6, g.sa};
    float m[3 * CHANNELS];
    for (int k = 0; k < 3 * CHANNELS; ++k)
        m[k] = of_groups[k] + (sum_of_lanes(matrix[k].hi) + sum_of_lanes(matrix[k].lo));
    float16 sent[2 * CHANNELS];
    for (int j = 0; j < ROWS; ++j) {
        if (j % 2 == 0)
            evaluate(list, n, lights, stride, nx, ny + j, nz + j, sent);
        float16 row[CHANNELS];
        for (int c = 0; c < CHANNELS; ++c) {
            row[c] = FMA(nx, (float16)(m[3 * c]), FMA(nz[j], (float16)(m[3 * c + 2]), (float16)(ny[j] * m[3 * c + 1])));
            row[c] += sent[j % 2 * CHANNELS + c];
            if (spilled)
                row[c] += sum[CHANNELS * j + c].hi + sum[CHANNELS * j + c].lo;
        }
        store_row(row[RED], row[GREEN], row[BLUE], c2[j], tile, j, resolution, image);
    }
}
