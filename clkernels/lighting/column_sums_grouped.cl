// Sums down the columns on a GPU, in place: column_sums.cl with bands of one row, bit for bit.
//
//     table(x, y) = sum over i <= x, j <= y of min(q(i, j), cap), see row_sums.cl
//
// A work-item sums one column over a part of the rows, then adds the sums of the parts above it.
//
// Arguments: column_sums.cl. One group of GROUP work-items per strip of COLUMNS columns.

#define PARTS (GROUP / COLUMNS)
#define AT_ONCE 8  // rows that are read before they are written

__attribute__((reqd_work_group_size(GROUP, 1, 1)))
kernel void column_sums_grouped(const uint width, const uint height, global ulong *restrict table)
{
    local ulong sums[GROUP];
    const uint i = get_local_id(0), part = i / COLUMNS, rows = (height + PARTS - 1) / PARTS;
    const uint x = get_global_id(0) / GROUP * COLUMNS + i % COLUMNS;
    const uint begin = min(part * rows, height), end = x < width ? min(begin + rows, height) : begin;
    table += x;

    ulong carry = 0;
#pragma unroll 8
    for (uint y = begin; y < end; ++y)
        carry += table[(size_t)y * width];
    sums[i] = carry;
    barrier(CLK_LOCAL_MEM_FENCE);
    carry = 0;
    for (uint above = i % COLUMNS; above < i; above += COLUMNS)
        carry += sums[above];
    for (uint first = begin; first < end; first += AT_ONCE) {
        ulong e[AT_ONCE];
#pragma unroll
        for (uint k = 0; k < AT_ONCE; ++k)
            e[k] = first + k < end ? table[(size_t)(first + k) * width] : 0;
#pragma unroll
        for (uint k = 0; k < AT_ONCE; ++k) {
            carry += e[k];
            if (first + k < end)
                table[(size_t)(first + k) * width] = carry;
        }
    }
}
