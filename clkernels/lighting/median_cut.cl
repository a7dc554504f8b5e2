// Cut a map into rectangles of equal energy (Debevec, A Median Cut Algorithm for Light Probe Sampling, 2005).
//
//     energy(first part) = energy(region) floor(n / 2) / n
//     lights(first part) = round(n energy(first part) / energy(region))
//
// A region for n lights is cut across its longer side, as close to the first equation as pixels allow. Its parts share
// the lights by the second one. The length along a row is measured where the region is nearest to the equator. Each
// part holds a lit pixel, and gets at most as many lights as it has lit pixels.
//
// energy, lit  summed-area tables of capped energy and of lit pixels, height x width integers of 64 bits, complete in the
//              last row of each band of BAND rows (column_sums.cl). With ALL_LIT every pixel is lit, and `lit` not read.
// edge_sine    height + 1 floats, sin(theta) of the rows' edges
// light_count  at most the number of lit pixels
// region       light_count x (x0, y0, x1, y1): columns x0 .. x1 - 1 and rows y0 .. y1 - 1
//
// One work-item per BLOCK lights: it walks down the tree of cuts to their regions. Of the lights of a region, the first
// ones go to its first part.

// The sum over columns before x and rows before y.
static inline ulong sum_before(global const ulong *table, uint width, uint x, uint y)
{
    if (x == 0 || y == 0)
        return 0;
    const uint whole = y - y % BAND;
    ulong sum = table[(size_t)(y - 1) * width + x - 1];
    if (0 < whole && whole < y)
        sum += table[(size_t)(whole - 1) * width + x - 1];
    return sum;
}

// The sum over all columns before k, in the rows of r (axis 0); or over all rows before k, in the columns of r (axis 1).
static inline ulong sum_along(global const ulong *table, uint width, uint4 r, int axis, uint k)
{
    if (axis == 0)
        return sum_before(table, width, k, r.w) - sum_before(table, width, k, r.y);
    return sum_before(table, width, r.z, k) - sum_before(table, width, r.x, k);
}

static inline ulong sum_over(global const ulong *table, uint width, uint4 r)
{
    return sum_along(table, width, r, 0, r.z) - sum_along(table, width, r, 0, r.x);
}

static inline uint lit_in(global const ulong *lit, uint width, uint4 r)
{
#ifdef ALL_LIT
    return (r.z - r.x) * (r.w - r.y);
#else
    return (uint)sum_over(lit, width, r);
#endif
}

// Where to cut r so that `target` of its `total` energy comes first; 0 if one row or column holds all of it.
static inline uint cut(global const ulong *energy, uint width, uint4 r, int axis, ulong target, ulong total)
{
    // Bisection: the energy before `low` is at most the target, and that before `high` is above it.
    uint low = axis == 0 ? r.x : r.y, high = axis == 0 ? r.z : r.w;
    const ulong before_r = sum_along(energy, width, r, axis, low);
    ulong before_low = 0, before_high = total;
    while (high - low > 1) {
        const uint middle = low + (high - low) / 2;
        const ulong before_middle = sum_along(energy, width, r, axis, middle) - before_r;
        if (before_middle > target) {
            high = middle;
            before_high = before_middle;
        } else {
            low = middle;
            before_low = before_middle;
        }
    }
    // The nearer of the two, if it leaves energy on both sides.
    if (before_low == 0)
        return before_high == total ? 0 : high;
    return before_high == total || target - before_low <= before_high - target ? low : high;
}

kernel void median_cut(global const ulong *restrict energy,
                       global const ulong *restrict lit,
                       global const float *restrict edge_sine,
                       const uint width,
                       const uint height,
                       const uint light_count,
                       global uint *restrict region)
{
    const uint begin = get_global_id(0) * BLOCK, end = min(begin + BLOCK, light_count);
    // Regions that wait, each for some of these lights: (first light, number of lights).
    uint4 waiting[BLOCK];
    uint2 waiting_lights[BLOCK];
    ulong waiting_total[BLOCK];
    uint waits = 0;

    uint4 r = (uint4)(0, 0, width, height);
    uint first = 0, n = light_count;
    ulong total = sum_over(energy, width, r);
    while (true) {
        while (n > 1) {
            const bool on_equator = 2 * r.y < height && 2 * r.w > height;
            const float sine = on_equator ? 1.0f : fmax(edge_sine[r.y], edge_sine[r.w]);
            const int longer = 2.0f * height * (r.z - r.x) * sine >= (float)width * (r.w - r.y) ? 0 : 1;

            const ulong target = total / n * (n / 2) + total % n * (n / 2) / n;
            int axis = longer;
            uint k = cut(energy, width, r, axis, target, total);
            if (k == 0) {
                axis = 1 - longer;
                k = cut(energy, width, r, axis, target, total);
            }
            const uint4 before = axis == 0 ? (uint4)(r.xy, k, r.w) : (uint4)(r.xyz, k);
            const uint4 after = axis == 0 ? (uint4)(k, r.yzw) : (uint4)(r.x, k, r.zw);
            const ulong part = sum_over(energy, width, before);
            const uint lit_before = lit_in(lit, width, before), lit_after = lit_in(lit, width, after);

            // The first part's share of the lights: round(n part / total), n <= 2^22, from energies shifted below 2^40,
            // so that the product fits into 64 bits.
            const uint shift = max(0, 24 - (int)clz(total));
            const ulong coarse = total >> shift;
            uint share = (uint)(((part >> shift) * n + coarse / 2) / coarse);
            share = clamp(share, max(1u, n > lit_after ? n - lit_after : 0u), min(lit_before, n - 1));

            if (first + share > begin) {
                if (first + share < end) {
                    waiting[waits] = after;
                    waiting_lights[waits] = (uint2)(first + share, n - share);
                    waiting_total[waits++] = total - part;
                }
                r = before;
                n = share;
                total = part;
            } else {
                r = after;
                first += share;
                n -= share;
                total -= part;
            }
        }
        vstore4(r, first, region);
        if (waits == 0)
            return;
        r = waiting[--waits];
        first = waiting_lights[waits].x;
        n = waiting_lights[waits].y;
        total = waiting_total[waits];
    }
}
