// The diffuse sphere under a whole environment map whose pixels are areas of constant radiance.
//
//     image(n) = integral of (albedo / pi) L(w) max(0, n . w) dw
//
// On a row of the map, the columns whose pixels lie wholly above the horizon form an arc about the normal's azimuth.
// They send n . M, where M, the sum of L^T times the integral of w over the pixel, is the difference of two prefix sums
// (arc_sums.cl). Beyond both ends of the arc, the horizon cuts columns: a few, or many where it runs along the row. Let
// u be the distance from the normal's azimuth, in columns. A column from u_0 to u_1 sends L (I(u_0) - I(u_1)), where
// I(u) is what a row of radiance 1 sends from u outwards. I is a piecewise polynomial, the same for a whole image row
// (horizon.py). It is exactly 0 from where the whole row is below the horizon, so a sun that has set adds nothing.
// Pieces are counted from the end of the arc, a whole number per column, so all normals use the same pieces for the
// next column.
//
// arcs         from arc_sums.cl, for rows first .. first + rows - 1, with integrals of w over pixels in place of w at
//              their centres
// radiance     height x width x 3 floats
// scale        a power of two that keeps sums inside float's range
// bounds       resolution x rows x 4: h_0, half the arc that is seen whole, and h_1, half the arc that is seen at all,
//              in columns; the pieces per column from h_0 to h_1; and their number m
// start        resolution x rows: the first of m + 1 polynomials
// polynomials  8 floats each, m for the pieces and one for the column before h_0: 7 coefficients in t, from the
//              constant up, where t is 0 at the piece's dark end and 1 at the other; and 1 / its length in columns
//
// Other arguments: sphere.clh. Source of n . M: Arvo, The Irradiance Jacobian (1994). One work-item per tile.

#include "common/image_sum.clh"
#include "common/angle.clh"
#include "common/fma.clh"
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

// The value of a polynomial at the distance x, in columns, from the dark end of its piece.
static inline wide polynomial(float8 c, wide x)
{
    const wide t = clamp(x * c.s7, 0.0f, 1.0f);
    wide sum = FMA(t, (wide)(c.s6), (wide)(c.s5));
    sum = FMA(t, sum, (wide)(c.s4));
    sum = FMA(t, sum, (wide)(c.s3));
    sum = FMA(t, sum, (wide)(c.s2));
    sum = FMA(t, sum, (wide)(c.s1));
    return FMA(t, sum, (wide)(c.s0));
}

// cut += L weight at column x of the row, for each pixel; columns wrap round.
static inline void add_column(private colour *cut, global const float *row, int width, wide_int x, wide weight)
{
    int at[WIDTH];
    float by[WIDTH];
    STORE_WIDE(x < 0 ? x + width : x >= width ? x - width : x, at);
    STORE_WIDE(fmax(weight, (wide)(0.0f)), by);
    for (int k = 0; k < WIDTH; ++k)
        cut[k] += radiance_at(row, at[k]) * by[k];
}

kernel void exact_areas(global const stored_arc *restrict arcs,
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
    const uint2 tile = own_tile(tiles);
    const size_t half_width = (width + 1) / 2, stride = half_width + width + 1;
    wide n_x, n_z;
    float n_y;
    float normal_x[WIDTH], normal_z[WIDTH];
    int inside[WIDTH];
    STORE_WIDE(tile_normals(tile, 0, resolution, &n_x, &n_y, &n_z), inside);
    if (WIDTH == 1 && inside[0] <= 0)
        return;
    STORE_WIDE(n_x, normal_x);
    STORE_WIDE(n_z, normal_z);
    const wide centre = turns(n_z, n_x) * (float)width;  // the normals' azimuths in columns

    bounds += (size_t)tile.y * rows * 4;
    start += (size_t)tile.y * rows;
    radiance += (size_t)first * width * 3;
    arc matrix[WIDTH];
    colour cut[WIDTH];
    for (int k = 0; k < WIDTH; ++k) {
        matrix[k] = 0.0f;
        cut[k] = 0.0f;
    }
    arc whole = 0.0f;
    for (uint r = 0; r < rows; ++r) {
        global const stored_arc *row = arc_row(arcs, r, half_width, stride);
        global const float *L = radiance + (size_t)r * width * 3;
        const float4 of_row = vload4(r, bounds);  // the host's memory need not be aligned to vectors
        const float h_0 = of_row.x, h_1 = of_row.y;
        if (h_1 <= 0.0f)
            continue;
        if (h_0 >= 0.5f * width) {
            whole += arc_between(row, stride, 0, width);
            continue;
        }
        const wide_int begin = to_wide_int(ceil(centre - h_0)), end = to_wide_int(floor(centre + h_0));
        if (h_0 >= 1.0f) {
            int from[WIDTH], to[WIDTH];
            STORE_WIDE(begin, from);
            STORE_WIDE(end, to);
#pragma unroll
            for (int k = 0; k < WIDTH; ++k)
                matrix[k] += arc_between(row, stride, from[k], to[k]);
        }

        global const float *p = polynomials + (size_t)start[r] * 8;
        const uint pieces = of_row.w, a_column = of_row.z;
        const float8 before = vload8(pieces, p);
        const float length = 1.0f / a_column;
        for (int side = -1; side <= 1; side += 2) {  // left, right
            wide_int x = side > 0 ? end : begin - 1;
            wide u = side > 0 ? to_wide(end) - centre : centre - to_wide(begin);
            wide left = polynomial(before, h_0 - fmax(u, (wide)(0.0f))) * scale;
            // An arc this short may hold no whole column: add the column at the normal's azimuth, from there to u.
            if (h_0 < 1.0f)
                add_column(cut, L, width, x - side, polynomial(before, (wide)(h_0)) * scale - left);
            for (uint next = 0; next < pieces; next += a_column) {
                u += 1.0f;
                // u lies in the column's last piece, even if rounding puts it beyond, or in an earlier one.
                const uint last = min(next + a_column, pieces) - 1;
                wide beyond = polynomial(vload8(last, p), fmin(h_0 + (last + 1) * length, h_1) - u) * scale;
                for (uint i = last; i-- > next;) {
                    const wide distance = h_0 + (i + 1) * length - u;
                    beyond = distance > 0.0f ? polynomial(vload8(i, p), distance) * scale : beyond;
                }
                add_column(cut, L, width, x, left - beyond);
                left = beyond;
                x += side;
            }
            add_column(cut, L, width, x, left);
        }
    }

    for (int k = 0; k < WIDTH; ++k)
        if (inside[k] > 0)
            add_to_pixel(light_of((float3)(normal_x[k], n_y, normal_z[k]), matrix[k] + whole) + cut[k],
                         (size_t)tile.y * resolution + tile.x + k, resolution, sum);
}
