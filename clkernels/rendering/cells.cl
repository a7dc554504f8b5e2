// An environment map cut into cells: each one's flux, a cone around its directions, and CDFs over its pixels.
//
//     f = scale (R + G + B)        flux(cell) = sum over its pixels of f sin(theta)
//
// radiance           height x width x 3 floats, finite and >= 0
// scale              a power of two that keeps the sum over the map inside float's range
// theta, phi         (sin, cos) of every row and of every column
// spread             by row: the largest distance of a direction from the centre of its pixel; 0 if all are centres
// size               pixels of a cell across and down; the last cells may have fewer
// cell_row_cdf       height x width integers (prefix_sum.clh), over the pixels of a row that share a cell
// cell_marginal_cdf  cells across x height integers, over the rows of a cell
// flux               cells down x cells across floats
// cell_cones         (axis, reach) of every cell: the mean direction of its light, and the distance of the
//                    farthest direction in a lit pixel from it
// cell_colours       (red, green, blue, 0): the channels' shares of every cell's flux; not written with GREY
//
// A cell has CDFs of its own, since a row's CDF may not resolve its pixels beside a bright pixel elsewhere in the row,
// although they may be all the light that some normals see.
//
// One work-item per cell.

#include "common/channels.clh"
#include "common/prefix_sum.clh"
#include "rendering/product.clh"

kernel void cells(global const float *restrict radiance,
                  global const float2 *restrict theta,
                  global const float2 *restrict phi,
                  global const float *restrict spread,
                  const uint width,
                  const uint height,
                  const uint2 size,
                  const float scale,
                  global uint *restrict cell_row_cdf,
                  global uint *restrict cell_marginal_cdf,
                  global float *restrict flux,
                  global float4 *restrict cell_cones,
                  global float4 *restrict cell_colours)
{
    const uint2 cell = (uint2)(get_global_id(0), get_global_id(1));
    const size_t index = cell.y * get_global_size(0) + cell.x;
    const uint2 first = cell * size, last = min(first + size, (uint2)(width, height));
    cell_marginal_cdf += (size_t)cell.x * height;

    float total = 0.0f;
    float3 axis = 0.0f, colour = 0.0f;
    for (uint y = first.y; y < last.y; ++y) {
        const size_t row = (size_t)y * width;
        const float2 t = theta[y];
        float sum = 0.0f;
        float2 along = 0.0f;
        float3 rgb = 0.0f;
        for (uint x = first.x; x < last.x; ++x) {
            const float3 L = vload3(row + x, radiance) * scale;
            const float f = L.x + L.y + L.z;
            cell_row_cdf[row + x] = as_uint(f);
            sum += f;
            along += f * phi[x];
            rgb += L;
        }
        weights_to_cdf(cell_row_cdf + row + first.x, last.x - first.x, sum);
        const float g = sum * t.x;
        cell_marginal_cdf[y] = as_uint(g);
        total += g;
        axis += t.x * (float3)(t.x * along.y, t.y * sum, t.x * along.x);
        colour += t.x * rgb;
    }
    weights_to_cdf(cell_marginal_cdf + first.y, last.y - first.y, total);
    axis = total > 0.0f ? plain_normalize(axis / total) : (float3)(0.0f, 1.0f, 0.0f);

    float reach = 0.0f;
    for (uint y = first.y; y < last.y; ++y)
        for (uint x = first.x; x < last.x; ++x) {
            const float3 L = vload3((size_t)y * width + x, radiance);
            const float2 t = theta[y], p = phi[x];
            if (L.x + L.y + L.z > 0.0f)
                reach = fmax(reach, plain_distance(axis, (float3)(t.x * p.y, t.y, t.x * p.x)) + spread[y]);
        }
    flux[index] = total;
    cell_cones[index] = (float4)(axis, reach + 1e-6f);
#ifndef GREY
    cell_colours[index] = total > 0.0f ? (float4)(colour / total, 0.0f) : (float4)(0.0f);
#endif
}
