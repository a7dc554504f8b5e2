// The limit of all that moves data: read floats and write them elsewhere.
//
//     to(i) = from(i)
//
// from, to  VECTORS x global size vectors of 4 floats
//
// One work-item VECTORS neighbouring vectors.

kernel void copy(global const float4 *restrict from, global float4 *restrict to)
{
    const size_t first = get_global_id(0) * VECTORS;
    for (size_t i = first; i < first + VECTORS; ++i)
        to[i] = from[i];
}
