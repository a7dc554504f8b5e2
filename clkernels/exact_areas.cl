// The diffuse sphere under a whole environment map whose pixels are areas of constant radiance.
//
//     image(n) = integral of (albedo / pi) L(w) max(0, n . w) dw
//
// On a row of the map, the columns whose pixels lie wholly above the horizon make an arc about the normal's azimuth.
// What they send is n . M, where M, the sum of L^T times the integral of w over the pixel, is the difference of two
// prefix sums (arc_sums.cl). At either end of the arc come the columns that the horizon cuts, a few, or many where it
// runs along the row. One from u_0 to u_1, distances from the normal's azimuth in columns, sends L (I(u_0) - I(u_1)), where
// I(u) is what an even row sends from u on. It is a polynomial in pieces, the same for all of an image row
// (horizon.py), and 0 from the end of the light on, to the last bit: a sun below the horizon leaves nothing.
//
// arcs         from arc_sums.cl, for rows first .. first + rows - 1, with integrals over pixels in place of centres
// radiance     height x width x 3 floats
// scale        a power of two that keeps sums inside float's range
// bounds       resolution x rows: half the arc that is seen whole and half the arc that is seen at all, in columns;
//              pieces a column between them; and their number m
// start        resolution x rows: the first of m + 1 polynomials
// polynomials  8 coefficients from the constant up: m for pieces, t = 0 to 1 from the dark end on; one for 1 column more
// tiles        (x, y) of each group of PIXELS pixels that meets the disc
// sum          2 x resolution x resolution x 3: high words, then low words of the rows so far; this adds its rows
//
// Source of n . M: Arvo, The Irradiance Jacobian (1994). One work-item a tile.

#include "double_word.clh"
#include "arc.clh"
#include "angle.clh"
#include "fma.clh"
#include "normal.clh"

// I(u)
static inline float beyond(float u, float4 bounds, global const float8 *polynomials)
{
    const float x = fmax(bounds.y - u, 0.0f) * bounds.z;
    const float piece = u < bounds.x ? bounds.w : fmin(floor(x), bounds.w - 1.0f);
    const float t = u < bounds.x ? bounds.x - u : x - piece;
    const float8 c = polynomials[(uint)piece];
    return FMA(t, FMA(t, FMA(t, FMA(t, FMA(t, FMA(t, c.s6, c.s5), c.s4), c.s3), c.s2), c.s1), c.s0);
}

#ifdef GREY
#define COLOUR(x, row) ((row)[3 * (x)])
typedef float colour;
#else
#define COLOUR(x, row) vload3(x, row)
typedef float3 colour;
#endif

kernel void exact_areas(global const arc *restrict arcs,
                        global const float *restrict radiance,
                        const float scale,
                        global const float4 *restrict bounds,
                        global const uint *restrict start,
                        global const float8 *restrict polynomials,
                        const uint width,
                        const uint first,
                        const uint rows,
                        const int resolution,
                        global const uint2 *restrict tiles,
                        global float *restrict sum)
{
    const uint2 tile = tiles[get_global_id(0)];
    const size_t half_width = (width + 1) / 2, stride = half_width + width + 1;
    float centre[PIXELS];  // the normals' azimuths in columns
    for (int k = 0; k < PIXELS; ++k) {
        const float3 n = pixel_normal(tile.x + k, tile.y, resolution);
        centre[k] = turns(n.z, n.x) * width;
    }

    bounds += (size_t)tile.y * rows;
    start += (size_t)tile.y * rows;
    radiance += (size_t)first * width * 3;
    arc matrix[PIXELS];
    colour cut[PIXELS];
    for (int k = 0; k < PIXELS; ++k) {
        matrix[k] = 0.0f;
        cut[k] = 0.0f;
    }
    arc whole = 0.0f;
    for (uint r = 0; r < rows; ++r) {
        global const arc *row = arcs + (r * stride + half_width) * 2;
        global const float *row_radiance = radiance + (size_t)r * width * 3;
        const float4 b = bounds[r];
        if (b.y <= 0.0f)
            continue;
        if (b.x >= 0.5f * width) {
            whole += row[2 * width] - row[0] + (row[2 * width + 1] - row[1]);
            continue;
        }
        global const float8 *p = polynomials + start[r];
        for (int k = 0; k < PIXELS; ++k) {
            int begin = (int)ceil(centre[k] - b.x), end = (int)floor(centre[k] + b.x);
            if (begin < end) {
                matrix[k] += row[2 * end] - row[2 * begin] + (row[2 * end + 1] - row[2 * begin + 1]);
            } else {  // the column of the normal's azimuth is cut at both ends
                end = (int)floor(centre[k]);
                begin = end + 1;
            }
            // Columns at the right end, then at the left end, until nothing is left beyond.
#pragma unroll
            for (int side = -1; side <= 1; side += 2) {
                int x = side > 0 ? end : begin - 1;
                float u = side > 0 ? end - centre[k] : centre[k] - begin;
                float left = beyond(fmax(u, 0.0f), b, p);
                while (u < b.y) {
                    u += 1.0f;
                    const float next = beyond(u, b, p);
                    const uint column = x < 0 ? x + width : x >= (int)width ? x - width : x;
                    cut[k] += COLOUR(column, row_radiance) * scale * fmax(left - next, 0.0f);
                    left = next;
                    x += side;
                }
            }
        }
    }

    for (int k = 0; k < PIXELS; ++k) {
        const uint x = tile.x + k;
        const float3 n = pixel_normal(x, tile.y, resolution);
        if (x >= resolution || n.z <= 0.0f)
            continue;
        const float3 rgb = light_of(n, matrix[k] + whole) + cut[k];
        const size_t at = (size_t)tile.y * resolution + x, at_low = at + (size_t)resolution * resolution;
        float3 hi = vload3(at, sum), lo = vload3(at_low, sum);
        DOUBLE_WORD_ADD(float3, hi, lo, rgb);
        vstore3(hi, at, sum);
        vstore3(lo, at_low, sum);
    }
}
