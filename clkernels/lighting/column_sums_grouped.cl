// Prefix sums down the columns on a GPU, in place, bit for bit those of column_sums.cl.
//
//     energy(x, y) = sum over i <= x, j <= y of min(q(i, j), cap), see row_sums.cl
//     lit(x, y)    = the number of these pixels that are lit
//
// A work-item sums one column over a part of the rows, then adds the sums of the parts above it.
//
// Arguments: column_sums.cl. One group of GROUP work-items per strip of COLUMNS columns.

#define PARTS (GROUP / COLUMNS)
#define AT_ONCE 8  // rows that are read before they are written

__attribute__((reqd_work_group_size(GROUP, 1, 1)))
kernel void column_sums_grouped(const uint width, const uint height, global ulong *restrict energy,
                                global uint *restrict lit)
{
    local ulong energy_sums[GROUP];
    local uint lit_sums[GROUP];
    const uint i = get_local_id(0), part = i / COLUMNS, rows = (height + PARTS - 1) / PARTS;
    const uint x = get_global_id(0) / GROUP * COLUMNS + i % COLUMNS;
    const uint begin = min(part * rows, height), end = x < width ? min(begin + rows, height) : begin;
    energy += x;
    lit += x;

    ulong energy_carry = 0;
    uint lit_carry = 0;
#pragma unroll 8
    for (uint y = begin; y < end; ++y) {
        energy_carry += energy[(size_t)y * width];
        lit_carry += lit[(size_t)y * width];
    }
    energy_sums[i] = energy_carry;
    lit_sums[i] = lit_carry;
    barrier(CLK_LOCAL_MEM_FENCE);
    energy_carry = lit_carry = 0;
    for (uint above = i % COLUMNS; above < i; above += COLUMNS) {
        energy_carry += energy_sums[above];
        lit_carry += lit_sums[above];
    }
    for (uint first = begin; first < end; first += AT_ONCE) {
        ulong e[AT_ONCE];
        uint l[AT_ONCE];
#pragma unroll
        for (uint k = 0; k < AT_ONCE; ++k) {
            e[k] = first + k < end ? energy[(size_t)(first + k) * width] : 0;
            l[k] = first + k < end ? lit[(size_t)(first + k) * width] : 0;
        }
#pragma unroll
        for (uint k = 0; k < AT_ONCE; ++k) {
            energy_carry += e[k];
            lit_carry += l[k];
            if (first + k < end) {
                energy[(size_t)(first + k) * width] = energy_carry;
                lit[(size_t)(first + k) * width] = lit_carry;
            }
        }
    }
}
