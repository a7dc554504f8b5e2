// A diffuse sphere lit by directional lights, without evaluating most of the pairs of pixel and light.
//
//     image(n) = sum over lights of E max(0, n . w) = n . M + sum over lights near the horizon
//
// The cosine is linear until it is clamped. The normals of a tile lie within `margin` of its axis, so a light
// with axis . w >= margin lights all of it unclamped, and one with axis . w <= -margin none of it. The
// unclamped ones need no work per pixel: their sum is n . M with the 3 x 3 matrix M = sum of w E^T
// (Arvo's vector irradiance, 1994). Only lights near the tile's horizon are evaluated pixel by pixel. The
// image is the brute-force one (shade.cl) up to rounding.
//
// tiles        (x, y) of each tile that meets the disc
// lights       6 rows of stride floats: w_x, w_y, w_z, and E = albedo / pi x flux in red, green, blue;
//              stride is a multiple of 16, the lights past the last one are zero
// image        resolution x resolution x 3, zeroed; pixels outside the disc are left alone
//
// One work-item a tile of 16 x ROWS pixels (ROWS even): vectors of 16 lights to classify and sum, vectors
// of 16 pixels to evaluate.

#define PIXELS 16
#include "double_word.clh"
#include "sphere.clh"

#define VECTORS_A_BLOCK 64  // vectors of lights whose sums are added before their rounding errors are kept
#define LIST 128            // lights near the horizon, evaluated when the list is full

typedef struct {
    float16 hi, lo;
} wide;

static inline float sum16(float16 v)
{
    const float8 e = v.lo + v.hi;
    const float4 q = e.lo + e.hi;
    const float2 p = q.lo + q.hi;
    return p.x + p.y;
}

static inline float max16(float16 v)
{
    const float8 e = fmax(v.lo, v.hi);
    const float4 q = fmax(e.lo, e.hi);
    const float2 p = fmax(q.lo, q.hi);
    return fmax(p.x, p.y);
}

static inline void add_to(private wide *sum, float16 x)
{
    DOUBLE_WORD_ADD(float16, sum->hi, sum->lo, x);
}

// Evaluate the listed lights on two rows of the tile, pixel by pixel.
static inline void evaluate(private const uint *list, uint n, global const float *lights, size_t stride,
                            float16 nx, float2 ny, private const float16 *nz, private wide *sum)
{
    float16 r0 = 0.0f, g0 = 0.0f, b0 = 0.0f, r1 = 0.0f, g1 = 0.0f, b1 = 0.0f;
    for (uint i = 0; i < n; ++i) {
        global const float *light = lights + list[i];
        const float16 x = nx * light[0];
        const float2 y = ny * light[stride];
        const float16 wz = light[2 * stride];
        const float16 red = light[3 * stride], green = light[4 * stride], blue = light[5 * stride];
        const float16 c0 = fmax(FMA(nz[0], wz, x + y.x), (float16)(0.0f));
        const float16 c1 = fmax(FMA(nz[1], wz, x + y.y), (float16)(0.0f));
        r0 = FMA(c0, red, r0);
        g0 = FMA(c0, green, g0);
        b0 = FMA(c0, blue, b0);
        r1 = FMA(c1, red, r1);
        g1 = FMA(c1, green, g1);
        b1 = FMA(c1, blue, b1);
    }
    add_to(sum + 0, r0);
    add_to(sum + 1, g0);
    add_to(sum + 2, b0);
    add_to(sum + 3, r1);
    add_to(sum + 4, g1);
    add_to(sum + 5, b1);
}

kernel void shade_tiles(global const uint2 *restrict tiles,
                        global const float *restrict lights,
                        const uint stride,
                        const int resolution,
                        global float *restrict image)
{
    const uint2 tile = tiles[get_global_id(0)];
    const float inverse_resolution = 1.0f / resolution;

    // The tile's normals, and their mean as its axis. Pixels outside the disc have c2 <= 0.
    const int16 a = TILE_A(tile, resolution);
    const float16 nx = convert_float16(a) * inverse_resolution;
    float2 ny[ROWS / 2];
    float16 nz[ROWS];
    int16 c2[ROWS];
    float16 mean_x = 0.0f, mean_y = 0.0f, mean_z = 0.0f;
    for (int j = 0; j < ROWS; ++j) {
        const int b = TILE_B(tile, j, resolution);
        const float y = b * inverse_resolution;
        ny[j / 2] = j % 2 ? (float2)(ny[j / 2].x, y) : (float2)(y, y);
        c2[j] = resolution * resolution - b * b - a * a;
        const float16 inside = select((float16)(0.0f), (float16)(1.0f), c2[j] > 0);
        nz[j] = sqrt(fmax(convert_float16(c2[j]), (float16)(0.0f))) * inverse_resolution;
        mean_x += inside * nx;
        mean_y += inside * y;
        mean_z += inside * nz[j];
    }
    const float3 axis = normalize((float3)(sum16(mean_x), sum16(mean_y), sum16(mean_z)));
    float16 chord2 = 0.0f;
    for (int j = 0; j < ROWS; ++j) {
        const float16 x = nx - axis.x, z = nz[j] - axis.z;
        const float y = (j % 2 ? ny[j / 2].y : ny[j / 2].x) - axis.y;
        chord2 = select(chord2, fmax(chord2, x * x + y * y + z * z), c2[j] > 0);
    }
    // |n . w - axis . w| <= |n - axis|; the rest covers what rounding adds.
    const float margin = sqrt(max16(chord2)) * 1.00001f + 1e-6f;

    wide sum[ROWS * 3];
    for (int k = 0; k < ROWS * 3; ++k)
        sum[k].hi = sum[k].lo = 0.0f;
    wide matrix[9];
    for (int k = 0; k < 9; ++k)
        matrix[k].hi = matrix[k].lo = 0.0f;
    uint list[LIST + PIXELS];
    uint n = 0;

    for (uint begin = 0; begin < stride; begin += VECTORS_A_BLOCK * PIXELS) {
        const uint end = min(begin + VECTORS_A_BLOCK * PIXELS, stride);
        float16 m0 = 0.0f, m1 = 0.0f, m2 = 0.0f, m3 = 0.0f, m4 = 0.0f, m5 = 0.0f, m6 = 0.0f, m7 = 0.0f, m8 = 0.0f;
        for (uint i = begin; i < end; i += PIXELS) {
            global const float *light = lights + i;
            const float16 wx = vload16(0, light), wy = vload16(0, light + stride);
            const float16 wz = vload16(0, light + 2 * (size_t)stride);
            const float16 d = FMA(wz, (float16)(axis.z), FMA(wy, (float16)(axis.y), wx * axis.x));
            const int16 lit = d >= margin;
            if (any(lit)) {
                const float16 zero = 0.0f;
                const float16 red = select(zero, vload16(0, light + 3 * (size_t)stride), lit);
                const float16 green = select(zero, vload16(0, light + 4 * (size_t)stride), lit);
                const float16 blue = select(zero, vload16(0, light + 5 * (size_t)stride), lit);
                m0 = FMA(wx, red, m0);
                m1 = FMA(wy, red, m1);
                m2 = FMA(wz, red, m2);
                m3 = FMA(wx, green, m3);
                m4 = FMA(wy, green, m4);
                m5 = FMA(wz, green, m5);
                m6 = FMA(wx, blue, m6);
                m7 = FMA(wy, blue, m7);
                m8 = FMA(wz, blue, m8);
            }
            const int16 near = fabs(d) < margin;
            if (any(near)) {
                int flags[PIXELS];
                vstore16(near, 0, flags);
                for (uint k = 0; k < PIXELS; ++k) {
                    list[n] = i + k;
                    n -= flags[k];  // true is -1 in a vector
                }
                if (n >= LIST) {
                    for (int j = 0; j < ROWS; j += 2)
                        evaluate(list, n, lights, stride, nx, ny[j / 2], nz + j, sum + 3 * j);
                    n = 0;
                }
            }
        }
        add_to(matrix + 0, m0);
        add_to(matrix + 1, m1);
        add_to(matrix + 2, m2);
        add_to(matrix + 3, m3);
        add_to(matrix + 4, m4);
        add_to(matrix + 5, m5);
        add_to(matrix + 6, m6);
        add_to(matrix + 7, m7);
        add_to(matrix + 8, m8);
    }
    for (int j = 0; j < ROWS; j += 2)
        evaluate(list, n, lights, stride, nx, ny[j / 2], nz + j, sum + 3 * j);

    float m[9];
    for (int k = 0; k < 9; ++k)
        m[k] = sum16(matrix[k].hi) + sum16(matrix[k].lo);
    for (int j = 0; j < ROWS; ++j) {
        const float y = j % 2 ? ny[j / 2].y : ny[j / 2].x;
        float rgb[3][PIXELS];
        int inside[PIXELS];
        for (int c = 0; c < 3; ++c) {
            const float16 linear = FMA(nx, (float16)(m[3 * c]), FMA(nz[j], (float16)(m[3 * c + 2]), (float16)(y * m[3 * c + 1])));
            vstore16(linear + sum[3 * j + c].hi, 0, rgb[c]);
        }
        vstore16(c2[j], 0, inside);
        for (int k = 0; k < PIXELS; ++k)
            if (inside[k] > 0)
                vstore3((float3)(rgb[0][k], rgb[1][k], rgb[2][k]),
                        (tile.y + j) * (size_t)resolution + tile.x + k, image);
    }
}
