// Cut a map into rectangles of equal energy (Debevec, A Median Cut Algorithm for Light Probe Sampling, 2005).
//
//     energy(first part) = energy(region) floor(n / 2) / n
//     lights(first part) = round(n energy(first part) / energy(region))
//
// A region for n lights is cut across its longer side, as close to the first equation as pixels allow. Its parts share
// the lights by the second one. The length along a row is measured where the region is nearest to the equator. Each
// part holds a lit pixel, and gets at most as many lights as it has lit pixels.
//
// energy, lit  height x width integers of 64 and 32 bits, summed-area tables (column_sums.cl)
// edge_sine    height + 1 floats, sin(theta) of the rows' edges
// light_count  at most the number of lit pixels
// region       light_count x (x0, y0, x1, y1): columns x0 .. x1 - 1 and rows y0 .. y1 - 1
//
// One work-item per light: it walks down the tree of cuts to its own region. Light i of a region for n lights goes to
// the first part if that part gets more than i lights.

// name(table, width, r): the sum over the region r, from a summed-area table of type T.
#define DEFINE_SUM_OVER(T, name)                                                            \
    static inline T name(global const T *table, uint width, uint4 r)                        \
    {                                                                                       \
        const size_t above = (size_t)(r.y - 1) * width, last = (size_t)(r.w - 1) * width;   \
        T sum = table[last + r.z - 1];                                                      \
        if (r.x > 0)                                                                        \
            sum -= table[last + r.x - 1];                                                   \
        if (r.y > 0)                                                                        \
            sum -= table[above + r.z - 1];                                                  \
        if (r.x > 0 && r.y > 0)                                                             \
            sum += table[above + r.x - 1];                                                  \
        return sum;                                                                         \
    }

DEFINE_SUM_OVER(ulong, energy_in)
DEFINE_SUM_OVER(uint, lit_in)

// The part of r before column (axis 0) or row (axis 1) k.
static inline uint4 before(uint4 r, int axis, uint k)
{
    return axis == 0 ? (uint4)(r.x, r.y, k, r.w) : (uint4)(r.x, r.y, r.z, k);
}

// Where to cut r so that `target` of its `total` energy comes first; 0 if one row or column holds all of it.
static inline uint cut(global const ulong *energy, uint width, uint4 r, int axis, ulong target, ulong total)
{
    // Bisection: the energy before `low` is at most the target, and that before `high` is above it.
    uint low = axis == 0 ? r.x : r.y, high = axis == 0 ? r.z : r.w;
    const uint begin = low;
    ulong before_high = total;
    while (high - low > 1) {
        const uint middle = low + (high - low) / 2;
        const ulong before_middle = energy_in(energy, width, before(r, axis, middle));
        if (before_middle > target) {
            high = middle;
            before_high = before_middle;
        } else {
            low = middle;
        }
    }
    const ulong before_low = low == begin ? 0 : energy_in(energy, width, before(r, axis, low));
    // The nearer of the two, if it leaves energy on both sides.
    if (before_low == 0)
        return before_high == total ? 0 : high;
    return before_high == total || target - before_low <= before_high - target ? low : high;
}

kernel void median_cut(global const ulong *restrict energy,
                       global const uint *restrict lit,
                       global const float *restrict edge_sine,
                       const uint width,
                       const uint height,
                       const uint light_count,
                       global uint *restrict region)
{
    uint4 r = (uint4)(0, 0, width, height);
    uint n = light_count, i = get_global_id(0);
    ulong total = energy_in(energy, width, r);
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
        const uint4 first = before(r, axis, k);
        const ulong part = energy_in(energy, width, first);
        const uint lit_first = lit_in(lit, width, first), lit_second = lit_in(lit, width, r) - lit_first;

        // The first part's share of the lights: round(n part / total), n <= 2^22, from energies shifted below 2^40, so
        // that the product fits into 64 bits.
        const uint shift = max(0, 24 - (int)clz(total));
        const ulong coarse = total >> shift;
        uint share = (uint)(((part >> shift) * n + coarse / 2) / coarse);
        share = clamp(share, max(1u, n > lit_second ? n - lit_second : 0u), min(lit_first, n - 1));

        if (i < share) {
            r = first;
            n = share;
            total = part;
        } else {
            r = axis == 0 ? (uint4)(k, r.y, r.z, r.w) : (uint4)(r.x, k, r.z, r.w);
            i -= share;
            n -= share;
            total -= part;
        }
    }
    vstore4(r, get_global_id(0), region);
}
