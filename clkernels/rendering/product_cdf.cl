// Coarse CDFs of light times cosine: for every tile of the image, over the cells of the map.
//
//     g(cell) = flux(cell) C(tile, cell)        total = sum over cells of g(cell)
//
// flux, cell_cones, cell_colours
//                    from cells.cl, cells.y x cells.x and 15 more, which are read but not used; for C see product.clh
// tile_cones         (axis, reach) of the normals of every tile that meets the disc
// total              one float per tile; zeroed by the host, and stays 0 for a tile outside the disc
// tile_row_cdf       a tile's cells.y x cells.x integers (prefix_sum.clh), over the cells of one row
// tile_marginal_cdf  a tile's cells.y integers, over its rows of cells
// tile_moments       CHANNELS vectors per tile: the sums over cells of flux h a m, and of flux h b (product.clh)
//
// One work-item per tile of tile_size x tile_size pixels.

#define WIDTH 16  // cells side by side

#include "common/prefix_sum.clh"
#include "common/normal.clh"
#include "rendering/product.clh"

#define LANE ((int16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15))

// The four components of 16 vectors.
static inline void load_fours(global const float4 *from, private float16 *to)
{
    global const float *p = (global const float *)from;
    const float16 a = vload16(0, p), b = vload16(1, p), c = vload16(2, p), d = vload16(3, p);
    to[0] = (float16)(a.s048c, b.s048c, c.s048c, d.s048c);
    to[1] = (float16)(a.s159d, b.s159d, c.s159d, d.s159d);
    to[2] = (float16)(a.s26ae, b.s26ae, c.s26ae, d.s26ae);
    to[3] = (float16)(a.s37bf, b.s37bf, c.s37bf, d.s37bf);
}

// Store the first n of 16 numbers.
static inline void store_lanes(uint16 v, uint n, global uint *to)
{
    if (n >= LANES) {
        store_unaligned(v, to);
        return;
    }
    uint one[LANES];
    vstore16(v, 0, one);
    for (uint k = 0; k < n; ++k)
        to[k] = one[k];
}

static inline void add_moment(float16 a, float16 b, private const float16 *m, private float16 *sum)
{
    sum[0] += a * m[0];
    sum[1] += a * m[1];
    sum[2] += a * m[2];
    sum[3] += b;
}

// The mean normal of the tile's pixels, and the distance of the farthest normal from it; 0 outside the disc.
static inline float4 bound_normals(int2 tile, int tile_size, int resolution)
{
    const int2 first = tile * tile_size, last = min(first + tile_size, resolution);
    float3 axis = 0.0f;
    for (int y = first.y; y < last.y; ++y)
        for (int x = first.x; x < last.x; ++x) {
            const float3 n = pixel_normal(x, y, resolution);
            axis += n.z > 0.0f ? n : (float3)(0.0f);
        }
    if (axis.z == 0.0f)
        return (float4)(0.0f);
    axis = plain_normalize(axis);
    float reach = 0.0f;
    for (int y = first.y; y < last.y; ++y)
        for (int x = first.x; x < last.x; ++x) {
            const float3 n = pixel_normal(x, y, resolution);
            if (n.z > 0.0f)
                reach = fmax(reach, plain_distance(n, axis));
        }
    return (float4)(axis, reach + 1e-6f);
}

kernel void product_cdf(global const float *restrict flux,
                        global const float4 *restrict cell_cones,
                        global const float4 *restrict cell_colours,
                        const uint2 cells,
                        const int tile_size,
                        const int resolution,
                        global float4 *restrict tile_cones,
                        global float *restrict total,
                        global uint *restrict tile_row_cdf,
                        global uint *restrict tile_marginal_cdf,
                        global float4 *restrict tile_moments)
{
    const size_t index = get_global_id(1) * get_global_size(0) + get_global_id(0);
    const float4 tile_cone = bound_normals((int2)(get_global_id(0), get_global_id(1)), tile_size, resolution);
    if (tile_cone.w == 0.0f)
        return;
    tile_cones[index] = tile_cone;
    tile_row_cdf += index * cells.y * cells.x;
    tile_marginal_cdf += index * cells.y;

    const float16 reach = tile_cone.w;
    float16 moments[CHANNELS][4] = {{0.0f}};
    for (uint j = 0; j < cells.y; ++j) {
        for (uint i = 0; i < cells.x; i += LANES) {
            const uint cell = j * cells.x + i;
            const int16 in_row = LANE + (int)i < (int)cells.x;
            float16 m[4], a, b;
            load_fours(cell_cones + cell, m);
            const float16 c = tile_cone.x * m[0] + tile_cone.y * m[1] + tile_cone.z * m[2], d = reach + m[3];
            const float16 of_cell = vload16(0, flux + cell);
            store_lanes(as_uint16(in_row ? of_cell * cosine_guess(c, d) : 0.0f), cells.x - i, tile_row_cdf + cell);

            cosine_line(c, d, &a, &b);
            a = in_row ? a * of_cell : 0.0f;
            b = in_row ? b * of_cell : 0.0f;
#ifdef GREY
            add_moment(a * (1.0f / 3.0f), b * (1.0f / 3.0f), m, moments[RED]);
#else
            float16 h[4];
            load_fours(cell_colours + cell, h);
            for (uint k = 0; k < CHANNELS; ++k)
                add_moment(a * h[k], b * h[k], m, moments[k]);
#endif
        }
        const float row_sum = sum_in_lanes(tile_row_cdf + j * cells.x, cells.x);
        weights_to_cdf(tile_row_cdf + j * cells.x, cells.x, row_sum);
        tile_marginal_cdf[j] = as_uint(row_sum);
    }
    const float sum = sum_in_lanes(tile_marginal_cdf, cells.y);
    weights_to_cdf(tile_marginal_cdf, cells.y, sum);
    total[index] = sum;
    for (uint k = 0; k < CHANNELS; ++k)
        tile_moments[index * CHANNELS + k] = (float4)(sum_of_lanes(moments[k][0]), sum_of_lanes(moments[k][1]),
                                                      sum_of_lanes(moments[k][2]), sum_of_lanes(moments[k][3]));
}
