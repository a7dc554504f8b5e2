// Sums down the columns, in place: they complete the summed-area table (Crow 1984) that row_sums.cl begins.
//
//     table(x, y) = sum over i <= x, j <= y of min(q(i, j), cap), see row_sums.cl, for the last row y of each band
//
// The sum down to any other row is the entry in the last row of the band above, plus the row's own entry.
//
// table  height x width integers of 64 bits
//
// One work-item per strip of COLUMNS columns.

kernel void column_sums(const uint width, const uint height, global ulong *restrict table)
{
    const uint first = get_global_id(0) * COLUMNS;
    const uint columns = min((uint)COLUMNS, width - first);
    ulong carry[COLUMNS] = {0};
    for (uint y = BAND - 1; y < height; y += BAND) {
        const size_t at = (size_t)y * width + first;
        for (uint x = 0; x < columns; ++x)
            table[at + x] = carry[x] += table[at + x];
    }
}
