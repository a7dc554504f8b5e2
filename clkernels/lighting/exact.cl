// The diffuse sphere under a whole environment map: every pixel of the map counts once, yet no loop runs over them.
//
//     image(n) = sum over pixels (x, y) of the map of row_weight(y) L(x, y) max(0, n . w)
//
// On the row of the map at the polar angle theta, the pixels above a normal's horizon form one arc about the normal's
// azimuth: cos(phi - phi_n) > q = -(n_y cos theta) / (sqrt(1 - n_y^2) sin theta). All pixels of an image row have the
// same n_y, so the arc's half angle depends only on the image row and the map row. The cosine is linear above the
// horizon, so the arc sends n . M, where M, the sum of w L^T over the arc, is the difference of two prefix sums
// (arc_sums.cl). An R x R image takes R^2 height steps, where the plain sum takes R^2 height width. A pixel at the very
// end of the arc is on the horizon and sends nothing, so it does not matter whether rounding counts it.
//
// arcs        from arc_sums.cl, for rows first .. first + rows - 1
// half_arc    resolution x height: the half angle in columns; 0 if none of the map row is above the horizon, width / 2
//             if all of it is
//
// Other arguments: sphere.clh. Source of n . M: Arvo, The Irradiance Jacobian (1994). One work-item per tile.

#include "common/image_sum.clh"
#include "common/angle.clh"
#include "lighting/arc.clh"
#include "lighting/sphere.clh"

#define PLAIN_ROWS 64  // rows that are summed in single precision

kernel void exact(global const stored_arc *restrict arcs,
                  global const float *restrict half_arc,
                  const uint width,
                  const uint height,
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
    const wide centre = turns(n_z, n_x) * (float)width - 0.5f;  // the normals' azimuths in columns

    half_arc += (size_t)tile.y * height + first;
    for (uint begin_row = 0; begin_row < rows; begin_row += PLAIN_ROWS) {
        const uint end_row = min(begin_row + PLAIN_ROWS, rows);
        arc matrix[WIDTH];
        for (int k = 0; k < WIDTH; ++k)
            matrix[k] = 0.0f;
        arc whole = 0.0f;
        for (uint r = begin_row; r < end_row; ++r) {
            global const stored_arc *row = arc_row(arcs, r, half_width, stride);
            const float h = half_arc[r];
            if (h <= 0.0f)
                continue;
            if (h >= 0.5f * width) {
                whole += arc_between(row, stride, 0, width);
                continue;
            }
            int begin[WIDTH], end[WIDTH];
            STORE_WIDE(to_wide_int(ceil(centre - h)), begin);
            STORE_WIDE(to_wide_int(floor(centre + h)) + 1, end);
#pragma unroll
            for (int k = 0; k < WIDTH; ++k)
                matrix[k] += arc_between(row, stride, begin[k], end[k]);
        }

        for (int k = 0; k < WIDTH; ++k)
            if (inside[k] > 0)
                add_to_pixel(light_of((float3)(normal_x[k], n_y, normal_z[k]), matrix[k] + whole),
                             (size_t)tile.y * resolution + tile.x + k, resolution, sum);
    }
}
