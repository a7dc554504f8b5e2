// The diffuse sphere under a whole environment map whose pixels are areas of constant radiance.
//
//     image(n) = integral of (albedo / pi) L(w) max(0, n . w) dw
//
// On a row of the map, the columns whose pixels lie wholly above the horizon make an arc about the normal's azimuth.
// What they send is n . M, where M, the sum of L^T times the integral of w over the pixel, is the difference of two
// prefix sums (arc_sums.cl). At either end of the arc come the columns that the horizon cuts, a few, or many where it
// runs along the row. One from u_0 to u_1, distances from the normal's azimuth in columns, sends L (I(u_0) - I(u_1)), where
// I(u) is what an even row sends from u on. It is a polynomial in pieces, the same for all of an image row
// (horizon.py), and 0 from the end of the light on, to the last bit: a sun below the horizon leaves nothing. Pieces
// begin where the arc ends, so the next column's end lies in the same piece for all normals.
//
// arcs         from arc_sums.cl, for rows first .. first + rows - 1, with integrals over pixels in place of centres
// radiance     height x width x 3 floats
// scale        a power of two that keeps sums inside float's range
// bounds       resolution x rows x 4: h_0, half the arc that is seen whole, and h_1, half the arc that is seen at all, in
//              columns; the pieces a column from h_0 to h_1; and their number m
// start        resolution x rows: the first of m + 1 polynomials
// polynomials  8 floats each: m for the pieces, one for a column before h_0; 7 coefficients from the constant up, and 1 /
//              the length of the piece in columns. They are in t from 0, the piece's dark end, to 1
// tiles        (x, y) of each group of PIXELS pixels that meets the disc
// sum          2 x resolution x resolution x 3: high words, then low words of the rows so far; this adds its rows
//
// Source of n . M: Arvo, The Irradiance Jacobian (1994). One work-item a tile.

#include "common/image_sum.clh"
#include "common/angle.clh"
#include "common/normal.clh"
#include "lighting/arc.clh"
#include "lighting/sphere.clh"

#ifdef GREY
typedef float colour;
#else
typedef float3 colour;
#endif

// L at column x of a row of the map.
static inline colour radiance_at(global const float *row, size_t x)
{
#ifdef GREY
    return row[3 * x];
#else
    return vload3(x, row);
#endif
}

// A polynomial at the distance x from the dark end of its piece.
static inline pixels polynomial(float8 c, pixels x)
{
    const pixels t = clamp(x * c.s7, 0.0f, 1.0f);
    pixels sum = FMA(t, (pixels)(c.s6), (pixels)(c.s5));
    sum = FMA(t, sum, (pixels)(c.s4));
    sum = FMA(t, sum, (pixels)(c.s3));
    sum = FMA(t, sum, (pixels)(c.s2));
    sum = FMA(t, sum, (pixels)(c.s1));
    return FMA(t, sum, (pixels)(c.s0));
}

// cut += L weight at column x of the row, for each pixel; columns go round.
static inline void add_column(private colour *cut, global const float *row, int width, ipixels x, pixels weight)
{
    int at[PIXELS];
    float by[PIXELS];
    STORE_PIXELS(x < 0 ? x + width : x >= width ? x - width : x, at);
    STORE_PIXELS(fmax(weight, (pixels)(0.0f)), by);
    for (int k = 0; k < PIXELS; ++k)
        cut[k] += radiance_at(row, at[k]) * by[k];
}

kernel void exact_areas(global const arc *restrict arcs,
                        global const float *restrict radiance,
                        const float scale,
                        global const float *restrict bounds,
                        global const uint *restrict start,
                        global const float *restrict polynomials,
                        const uint width,
                        const uint first,
                        const uint rows,
                        const int resolution,
                        global const uint2 *restrict tiles,
                        global float *restrict sum)
{
    const uint2 tile = tiles[get_global_id(0)];
    const size_t half_width = (width + 1) / 2, stride = half_width + width + 1;
    float azimuth[PIXELS];  // the normals', in columns
    for (int k = 0; k < PIXELS; ++k) {
        const float3 n = pixel_normal(tile.x + k, tile.y, resolution);
        azimuth[k] = turns(n.z, n.x) * width;
    }
    const pixels centre = LOAD_PIXELS(azimuth);

    bounds += (size_t)tile.y * rows * 4;
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
        global const float *L = radiance + (size_t)r * width * 3;
        const float4 of_row = vload4(r, bounds);  // the host's memory need not be aligned to vectors
        const float h_0 = of_row.x, h_1 = of_row.y;
        if (h_1 <= 0.0f)
            continue;
        if (h_0 >= 0.5f * width) {
            whole += row[2 * width] - row[0] + (row[2 * width + 1] - row[1]);
            continue;
        }
        const ipixels begin = pixels_to_int(ceil(centre - h_0)), end = pixels_to_int(floor(centre + h_0));
        if (h_0 >= 1.0f) {
            int from[PIXELS], to[PIXELS];
            STORE_PIXELS(2 * begin, from);
            STORE_PIXELS(2 * end, to);
#pragma unroll
            for (int k = 0; k < PIXELS; ++k)
                matrix[k] += row[to[k]] - row[from[k]] + (row[to[k] + 1] - row[from[k] + 1]);
        }

        global const float *p = polynomials + (size_t)start[r] * 8;
        const uint pieces = of_row.w, a_column = of_row.z;
        const float8 before = vload8(pieces, p);
        const float length = 1.0f / a_column;
        for (int side = -1; side <= 1; side += 2) {  // left, right
            ipixels x = side > 0 ? end : begin - 1;
            pixels u = side > 0 ? pixels_from_int(end) - centre : centre - pixels_from_int(begin);
            pixels left = polynomial(before, h_0 - fmax(u, (pixels)(0.0f))) * scale;
            // Not sure to see a column whole: the one of the normal's azimuth, from there to u.
            if (h_0 < 1.0f)
                add_column(cut, L, width, x - side, polynomial(before, (pixels)(h_0)) * scale - left);
            for (uint next = 0; next < pieces; next += a_column) {
                u += 1.0f;
                // The piece that u lies in; the column's last also where rounding puts u beyond it.
                const uint last = min(next + a_column, pieces) - 1;
                pixels beyond = polynomial(vload8(last, p), fmin(h_0 + (last + 1) * length, h_1) - u) * scale;
                for (uint i = last; i-- > next;) {
                    const pixels distance = h_0 + (i + 1) * length - u;
                    beyond = distance > 0.0f ? polynomial(vload8(i, p), distance) * scale : beyond;
                }
                add_column(cut, L, width, x, left - beyond);
                left = beyond;
                x += side;
            }
            add_column(cut, L, width, x, left);
        }
    }

    for (int k = 0; k < PIXELS; ++k) {
        const uint x = tile.x + k;
        const float3 n = pixel_normal(x, tile.y, resolution);
        if (x >= resolution || n.z <= 0.0f)
            continue;
        const float3 rgb = light_of(n, matrix[k] + whole) + cut[k];
        add_to_pixel(rgb, (size_t)tile.y * resolution + x, resolution, sum);
    }
}
