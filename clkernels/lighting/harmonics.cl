// A diffuse sphere lit by spherical harmonics.
//
//     image(n) = sum over l, m of c_lm Y_lm(n)
//
// with the polar axis +y: Y_lm = p_lm(n_y) Re or Im (n_x + i n_z)^m. The power contains the factor sin^m(theta) of the
// associated Legendre function; p_lm is the rest of that function, by the recurrence in l
//
//     p_lm = a_lm n_y p_{l-1,m} - b_lm p_{l-2,m}        p_mm = a_mm
//
// terms  for m = 0 .. order, for l = m .. order, 8 floats: a, b, c_lm of R, G, B for the real part, and the same three
//        for the imaginary part
//
// Other arguments: sphere.clh. One work-item per tile of one row.

#include "common/fma.clh"
#include "lighting/sphere.clh"

kernel void harmonics(global const uint2 *restrict tiles,
                      global const float *restrict terms,
                      const uint order,
                      const int resolution,
                      global float *restrict image)
{
    const uint2 tile = tiles[get_global_id(0)];
    wide x, z;
    float y;
    const wide_int c2 = tile_normals(tile, 0, resolution, &x, &y, &z);

    wide red = 0.0f, green = 0.0f, blue = 0.0f, real = 1.0f, imaginary = 0.0f;
    for (uint m = 0; m <= order; ++m) {
        wide red_c = 0.0f, green_c = 0.0f, blue_c = 0.0f, red_s = 0.0f, green_s = 0.0f, blue_s = 0.0f;
        wide p = 0.0f, p_before = 0.0f;
        for (uint l = m; l <= order; ++l, terms += 8) {
            const wide p_now = l == m ? (wide)(terms[0]) : terms[0] * (y * p) - terms[1] * p_before;
            p_before = p;
            p = p_now;
            if (l > 1 && l % 2 == 1)  // the clamped cosine has no such terms
                continue;
            red_c = FMA(p, (wide)(terms[2]), red_c);
            green_c = FMA(p, (wide)(terms[3]), green_c);
            blue_c = FMA(p, (wide)(terms[4]), blue_c);
            red_s = FMA(p, (wide)(terms[5]), red_s);
            green_s = FMA(p, (wide)(terms[6]), green_s);
            blue_s = FMA(p, (wide)(terms[7]), blue_s);
        }
        red += red_c * real + red_s * imaginary;
        green += green_c * real + green_s * imaginary;
        blue += blue_c * real + blue_s * imaginary;
        const wide next = real * x - imaginary * z;
        imaginary = real * z + imaginary * x;
        real = next;
    }
    store_row(red, green, blue, c2, tile, 0, resolution, image);
}
