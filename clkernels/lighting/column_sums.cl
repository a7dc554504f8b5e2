// Prefix sums down the columns, in place: they complete the summed-area tables (Crow 1984) that row_sums.cl begins.
//
//     energy(x, y) = sum over i <= x, j <= y of min(q(i, j), cap), see row_sums.cl
//     lit(x, y)    = the number of these pixels that are lit
//
// energy, lit  height x width integers of 64 and 32 bits
//
// One work-item per strip of COLUMNS columns.

kernel void column_sums(const uint width, const uint height, global ulong *restrict energy, global uint *restrict lit)
{
    const uint first = get_global_id(0) * COLUMNS;
    const uint columns = min((uint)COLUMNS, width - first);
    ulong energy_carry[COLUMNS] = {0};
    uint lit_carry[COLUMNS] = {0};
    for (uint y = 0; y < height; ++y) {
        const size_t at = (size_t)y * width + first;
        for (uint x = 0; x < columns; ++x) {
            energy_carry[x] += energy[at + x];
            energy[at + x] = energy_carry[x];
            lit_carry[x] += lit[at + x];
            lit[at + x] = lit_carry[x];
        }
    }
}
