// Sums over spans of a map's rows: of the radiance, and of its moments along the row.
//
//     sum = sum over x in [begin, end) of scale (R, G, B, I cos(phi_x), I sin(phi_x)), I = R + G + B
//
// radiance  height x width x 3 floats
// phi       (sin, cos) of every column
// scale     a power of two that keeps sums inside float's range
// span      for each span (y, begin, end, index of its first sum); a last entry holds the number of all sums
// count     the number of all sums
// sum       5 x count floats
//
// One work-item per span, of one row. Sums are double words, so a span may be as long as a row.

#include "common/double_word.clh"

kernel void span_sums(global const float *restrict radiance,
                      global const float2 *restrict phi,
                      const uint width,
                      const float scale,
                      global const uint *restrict span,
                      const uint count,
                      global float *restrict sum)
{
    const uint4 s = vload4(get_global_id(0), span);
    float8 hi = 0.0f, lo = 0.0f;
    for (uint x = s.y; x < s.z; ++x) {
        const float3 L = vload3((size_t)s.x * width + x, radiance) * scale;
        const float intensity = L.x + L.y + L.z;
        const float8 term = (float8)(L.x, L.y, L.z, intensity * phi[x].y, intensity * phi[x].x, 0.0f, 0.0f, 0.0f);
        DOUBLE_WORD_ADD(float8, hi, lo, term);
    }
    sum += s.w;
    sum[0] = hi.s0;
    sum[count] = hi.s1;
    sum[2 * (size_t)count] = hi.s2;
    sum[3 * (size_t)count] = hi.s3;
    sum[4 * (size_t)count] = hi.s4;
}
