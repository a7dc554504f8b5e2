// Sums over spans of up to 8 rows of a map, bit for bit those of span_sums.cl for each of the rows.
//
//     sum = sum over x in [begin, end) of scale (R, G, B, I cos(phi_x), I sin(phi_x)), I = R + G + B
//
// Arguments: span_sums.cl. One work-item per span. An addition of double words waits for the one before it, so the rows
// are summed side by side. A span has as many rows as there are sums from its first one to the next span's.

#include "common/double_word.clh"

#define OF_ROWS(i) (float8)(row0[i], row1[i], row2[i], row3[i], row4[i], row5[i], row6[i], row7[i])
#define BELOW(row, number) row + (number < rows ? line : 0)

static inline void store_rows(float8 v, uint rows, global float *to)
{
    float of_row[8];
    vstore8(v, 0, of_row);
    for (uint row = 0; row < rows; ++row)
        to[row] = of_row[row];
}

kernel void tall_span_sums(global const float *restrict radiance,
                           global const float2 *restrict phi,
                           const uint width,
                           const float scale,
                           global const uint *restrict span,
                           const uint count,
                           global float *restrict sum)
{
    const uint4 s = vload4(get_global_id(0), span);
    const uint rows = vload4(get_global_id(0) + 1, span).w - s.w;
    const size_t line = 3 * (size_t)width;
    // Pointers past the last row repeat it. With one pointer and an array of offsets, PoCL 3.1 takes twice as long.
    global const float *row0 = radiance + s.x * line, *row1 = BELOW(row0, 1), *row2 = BELOW(row1, 2),
                       *row3 = BELOW(row2, 3), *row4 = BELOW(row3, 4), *row5 = BELOW(row4, 5), *row6 = BELOW(row5, 6),
                       *row7 = BELOW(row6, 7);

    float16 red_green = 0.0f, red_green_lo = 0.0f, blue_x = 0.0f, blue_x_lo = 0.0f;
    float8 moment_z = 0.0f, moment_z_lo = 0.0f;
    for (uint x = s.y; x < s.z; ++x) {
        const size_t i = 3 * (size_t)x;
        const float8 red = OF_ROWS(i) * scale, green = OF_ROWS(i + 1) * scale, blue = OF_ROWS(i + 2) * scale;
        const float8 intensity = red + green + blue, z = intensity * phi[x].x;
        const float16 first = (float16)(red, green), second = (float16)(blue, intensity * phi[x].y);
        DOUBLE_WORD_ADD(float16, red_green, red_green_lo, first);
        DOUBLE_WORD_ADD(float16, blue_x, blue_x_lo, second);
        DOUBLE_WORD_ADD(float8, moment_z, moment_z_lo, z);
    }
    sum += s.w;
    store_rows(red_green.lo, rows, sum);
    store_rows(red_green.hi, rows, sum + count);
    store_rows(blue_x.lo, rows, sum + 2 * (size_t)count);
    store_rows(blue_x.hi, rows, sum + 3 * (size_t)count);
    store_rows(moment_z, rows, sum + 4 * (size_t)count);
}
