// The limit for everything that moves data: read floats and write them elsewhere.
//
//     to(i) = from(i)
//
// from, to  global size x VECTORS vectors of 4 floats
//
// One work-item per VECTORS neighbouring vectors of 4 floats.

kernel void copy(global const float4 *restrict from, global float4 *restrict to)
{
    const size_t first = get_global_id(0) * VECTORS;
    for (size_t i = first; i < first + VECTORS; ++i)
        to[i] = from[i];
}
