// The weights of a map's pixels without sin(theta), for kernels that need only probabilities. They take a third of the
// radiance's memory, so more of them fit in the cache.
//
//     f(x, y) = scale (R + G + B)
//
// radiance  height x width x 3 floats
// scale     a power of two that keeps the sum over the map inside float's range
// f         height x width floats
//
// One work-item per row.

#include "common/map_row.clh"

#pragma OPENCL FP_CONTRACT OFF

kernel void map_weights(global const float *restrict radiance,
                        const uint width,
                        const float scale,
                        global float *restrict f)
{
    const size_t row = get_global_id(0) * width;
    for (uint x = 0; x < width; ++x)
        f[row + x] = weight(radiance + 3 * (row + x), scale);
}
