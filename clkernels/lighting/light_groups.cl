// Bounds and sums of groups of LANES lights, for shade_tiles.cl: if all of a group lights a tile, or none of it does,
// the tile needs nothing else of the group.
//
//     matrix = sum of w E^T,  axis = normalised sum of w,  reach = max |w - axis|,  all over the lights of the group
//
// lights   6 rows of stride floats, or 4 with GREY, see shade_tiles.cl
// bounds   a group's (axis, reach)
// matrix   a group's 3 x 3 matrix: 3 x (E_r, E_g, E_b, 0) for w_x, w_y, w_z, and 4 zeros
//
// One work-item per group.

#include "common/channels.clh"
#include "common/lanes.clh"

kernel void light_groups(global const float *restrict lights,
                         const uint stride,
                         global float4 *restrict bounds,
                         global float *restrict matrix)
{
    const size_t group = get_global_id(0);
    lights += group * LANES;
    float3 axis = 0.0f, x = 0.0f, y = 0.0f, z = 0.0f;
    for (uint i = 0; i < LANES; ++i) {
        const float3 w = (float3)(lights[i], lights[stride + i], lights[2 * (size_t)stride + i]);
        const float3 E = (float3)(lights[(3 + RED) * (size_t)stride + i], lights[(3 + GREEN) * (size_t)stride + i],
                                  lights[(3 + BLUE) * (size_t)stride + i]);
        axis += w;
        x += E * w.x;
        y += E * w.y;
        z += E * w.z;
    }
    const float length2 = dot(axis, axis);
    axis = length2 > 1e-6f ? axis / sqrt(length2) : (float3)(0.0f, 0.0f, 1.0f);
    float reach = 0.0f;
    for (uint i = 0; i < LANES; ++i)
        reach = fmax(reach, distance(axis, (float3)(lights[i], lights[stride + i], lights[2 * (size_t)stride + i])));
    bounds[group] = (float4)(axis, reach * 1.00001f + 1e-6f);
    vstore16((float16)(x, 0.0f, y, 0.0f, z, 0.0f, (float4)(0.0f)), group, matrix);
}
