// The weights of a map's pixels without sin(theta): f = scale (R + G + B).
//
// A third of the radiance's memory: where only probabilities are asked for, more of it lies in the cache.
// One work-item a row.

#include "common/map_row.clh"

#pragma OPENCL FP_CONTRACT OFF

kernel void map_weights(global const float *restrict radiance, const uint width, const float scale, global float *restrict f)
{
    const size_t row = get_global_id(0) * width;
    for (uint x = 0; x < width; ++x)
        f[row + x] = weight(radiance + 3 * (row + x), scale);
}
