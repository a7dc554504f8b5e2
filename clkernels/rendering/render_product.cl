// Per-pixel Monte Carlo of the diffuse sphere, with light samples that know about the cosine.
//
// A tile of normals picks a cell of the map with probability proportional to flux(cell) C(tile, cell), and the cell picks
// a pixel by S sin(theta) (product_cdf.cl, cells.cl). So the density is proportional to S C, and the image is
// albedo / pi times the tile's total times solid angle / sin(theta), times the mean over samples of
//
//     (L / S) (c / C)
//
// L / S is at most 1 and the cosine at most 4 C: nothing overflows. Few directions below the horizon are drawn, and the
// noise of the cosine is gone but for the size of cells and tiles.
// (Two-stage importance sampling: Cline et al. 2006; product sampling: Clarberg et al. 2005.)
//
// Arguments are those of pixel_block.clh, those from product_cdf.cl (tile_*) and cells.cl (cell_*), and
//
// disc           in which pixels of a tile, which share its CDFs, lie next to each other
// inverse_total  1 / the sum of S sin(theta) over the map, so that a tile's total leaves `sum` without the map's scale
//
// One work-item BLOCK pixels, in short loops.

#include "rendering/pixel_block.clh"
#include "common/block_search.clh"
#include "rendering/product.clh"

// block_search, and u[k] becomes its place in the step that it picked, a fraction of 2^32, uniform again.
static inline void search_rest(global const uint *cdf, const uint n, private const uint *base,
                               private const uint *last, private const uint *total, private uint *u,
                               private uint *index)
{
    block_search(cdf, n, base, last, total, u, index);
    SCALAR_LOADS
    for (uint k = 0; k < BLOCK; ++k) {
        global const uint *at = cdf + base[k] + index[k];
        const uint below = index[k] > 0 ? at[-1] : 0;
        u[k] = (uint)(((ulong)u[k] * total[k] - ((ulong)below << 32)) / (at[0] - below));
    }
}

kernel void render_product(global const uint *restrict tile_row_cdf,
                           global const uint *restrict tile_marginal_cdf,
                           global const float4 *restrict tile_cones,
                           global const float *restrict tile_total,
                           const uint tile_size,
                           const uint tiles_across,
                           global const uint *restrict cell_row_cdf,
                           global const uint *restrict cell_marginal_cdf,
                           global const float4 *restrict cell_cones,
                           const uint2 cells,
                           const uint2 cell_size,
                           global const float *restrict radiance,
                           global const float2 *restrict theta,
                           global const float2 *restrict phi,
                           const uint width,
                           const uint height,
                           const float scale,
                           const float inverse_total,
                           global const uint2 *restrict disc,
                           const uint pixel_count,
                           const uint2 seed,
                           const uint begin,
                           const uint end,
                           const int resolution,
                           global float *restrict sum)
{
    pixel_block block;
    begin_block(&block, disc, pixel_count, begin, seed, resolution);

    uint tile_marginal[BLOCK], marginal_total[BLOCK], last_row[BLOCK], last_column[BLOCK];
    block3 tile_axis;
    float tile_reach[BLOCK], factor[BLOCK];
    for (uint k = 0; k < BLOCK; ++k) {
        const uint2 at = (uint2)(block.index[k] % resolution, block.index[k] / resolution) / tile_size;
        const uint t = at.y * tiles_across + at.x;
        tile_axis.x[k] = tile_cones[t].x;
        tile_axis.y[k] = tile_cones[t].y;
        tile_axis.z[k] = tile_cones[t].z;
        tile_reach[k] = tile_cones[t].w;
        factor[k] = tile_total[t] * inverse_total;
        tile_marginal[k] = t * cells.y;
        marginal_total[k] = tile_marginal_cdf[tile_marginal[k] + cells.y - 1];
        last_row[k] = cells.y - 1;
        last_column[k] = cells.x - 1;
    }

    for (uint s = begin; s < end; ++s) {
        uint across[BLOCK], down[BLOCK], i[BLOCK], j[BLOCK], x[BLOCK], y[BLOCK];
        uint base[BLOCK], last[BLOCK], total[BLOCK];
        next_points(&block.streams, s, across, down);

        // A cell (i, j), by the CDFs of the pixel's tile
        search_rest(tile_marginal_cdf, cells.y, tile_marginal, last_row, marginal_total, down, j);
        SCALAR_LOADS
        for (uint k = 0; k < BLOCK; ++k) {
            base[k] = (tile_marginal[k] + j[k]) * cells.x;
            total[k] = tile_row_cdf[base[k] + cells.x - 1];
        }
        search_rest(tile_row_cdf, cells.x, base, last_column, total, across, i);

        // A pixel (x, y) of the map, by the CDFs of the cell and the rest of the point
        SCALAR_LOADS
        for (uint k = 0; k < BLOCK; ++k) {
            last[k] = min(cell_size.y, height - j[k] * cell_size.y) - 1;
            base[k] = i[k] * height + j[k] * cell_size.y;
            total[k] = cell_marginal_cdf[base[k] + last[k]];
        }
        block_search(cell_marginal_cdf, cell_size.y, base, last, total, down, y);
        SCALAR_LOADS
        for (uint k = 0; k < BLOCK; ++k) {
            y[k] += j[k] * cell_size.y;
            last[k] = min(cell_size.x, width - i[k] * cell_size.x) - 1;
            base[k] = y[k] * width + i[k] * cell_size.x;
            total[k] = cell_row_cdf[base[k] + last[k]];
        }
        block_search(cell_row_cdf, cell_size.x, base, last, total, across, x);
        for (uint k = 0; k < BLOCK; ++k)
            x[k] += i[k] * cell_size.x;

        // max(0, n . w) / C
        block3 cell_axis;
        float cell_reach[BLOCK], weight[BLOCK];
        SCALAR_LOADS
        for (uint k = 0; k < BLOCK; ++k) {
            const float4 cone = cell_cones[j[k] * cells.x + i[k]];
            cell_axis.x[k] = cone.x;
            cell_axis.y[k] = cone.y;
            cell_axis.z[k] = cone.z;
            cell_reach[k] = cone.w;
        }
        block_directions w;
        block_centres(theta, phi, x, y, &w);
        for (uint k = 0; k < BLOCK; k += WIDTH) {
            const wide sine = LOAD_WIDE(w.sin_theta + k);
            const wide cosine = LOAD_WIDE(block.normal.x + k) * (sine * LOAD_WIDE(w.cos_phi + k))
                              + LOAD_WIDE(block.normal.y + k) * LOAD_WIDE(w.cos_theta + k)
                              + LOAD_WIDE(block.normal.z + k) * (sine * LOAD_WIDE(w.sin_phi + k));
            const wide c = LOAD_WIDE(tile_axis.x + k) * LOAD_WIDE(cell_axis.x + k)
                         + LOAD_WIDE(tile_axis.y + k) * LOAD_WIDE(cell_axis.y + k)
                         + LOAD_WIDE(tile_axis.z + k) * LOAD_WIDE(cell_axis.z + k);
            const wide guess = cosine_guess(c, LOAD_WIDE(tile_reach + k) + LOAD_WIDE(cell_reach + k));
            STORE_WIDE(cosine > 0.0f ? cosine / guess : (wide)(0.0f), weight + k);
        }

        // L / S x max(0, n . w) / C
        block_add_colours(&block.samples, radiance, width, scale, x, y, weight);
    }

    // What all samples of a pixel have in common
    for (uint c = 0; c < CHANNELS; ++c)
        for (uint k = 0; k < BLOCK; ++k)
            block.samples.channel[c][k] *= factor[k];
    end_block(&block, pixel_count, resolution, sum);
}
