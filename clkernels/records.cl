// A map's pixels for searches: (CDF of the row, R, G, B), so that the search that ends at a pixel has its radiance
// in the same cache line.
//
// One work-item a row.

kernel void records(global const uint *restrict row_cdf,
                    global const float *restrict radiance,
                    const uint width,
                    global uint *restrict records)
{
    const size_t first = get_global_id(0) * width;
    for (size_t i = first; i < first + width; ++i) {
        records[4 * i] = row_cdf[i];
        records[4 * i + 1] = as_uint(radiance[3 * i]);
        records[4 * i + 2] = as_uint(radiance[3 * i + 1]);
        records[4 * i + 3] = as_uint(radiance[3 * i + 2]);
    }
}
