"""Every sequence is uniform, and as evenly spread as it claims."""

from __future__ import annotations

import math
import re
from runpy import run_path

import numpy as np
import pytest
from helpers import ROOT
from lightdome import reference
from lightdome.maps.envmap import EnvironmentMap
from lightdome.opencl.device import Device
from lightdome.sampling.distribution import Distribution, build_distribution
from lightdome.sampling.lattice import figure_of_merit, generator
from lightdome.sampling.samples import SEQUENCES

N = 64


@pytest.fixture(scope="module")
def square(device: Device) -> Distribution:
    """A map with equally likely pixels, so that a sample's pixel shows its point, to 1 / 64."""
    theta, _ = reference.angles(N, N)
    return build_distribution(device, EnvironmentMap(np.repeat(1 / np.sin(theta)[..., None], 3, axis=2)))


def cells(distribution: Distribution, count: int, sequence: str, seed: int, columns: int, rows: int) -> np.ndarray:
    """The number of samples in each of columns x rows cells of equal area."""
    x, y = distribution.sample(count, seed, sequence).pixel.T
    return np.bincount(y * rows // N * columns + x * columns // N, minlength=columns * rows)


WHOLE = ((0, 1), (0, 1))
SLOWER = [pytest.param(name, marks=pytest.mark.slow) for name in SEQUENCES if name != "independent"]


@pytest.mark.parametrize("sequence", ["independent", *SLOWER])
def test_every_point_is_uniform_over_the_seeds(square: Distribution, sequence: str) -> None:
    pixel = np.array([square.sample(5, seed, sequence).pixel[[0, 4]] for seed in range(800)])
    # Where the first and last of five points may lie, across and down; stratified has strips of three and two.
    cells_of = [((0, 1 / 3), (0, 3 / 5)), ((1 / 2, 1), (3 / 5, 1))] if sequence == "stratified" else [WHOLE, WHOLE]
    edges = np.arange(9) / 8
    for point, cell in enumerate(cells_of):
        for axis, (low, high) in enumerate(cell):
            seen = np.bincount(pixel[:, point, axis] // 8, minlength=8)
            expected = 800 * np.diff(edges.clip(low, high)) / (high - low)
            assert not seen[expected == 0].any()
            assert ((seen - expected)[expected > 0] ** 2 / expected[expected > 0]).sum() < 30
    total = sum(cells(square, 7, sequence, seed, 4, 4) for seed in range(400))
    assert ((total - 175) ** 2 / 175).sum() < 45


@pytest.mark.parametrize("seed", [0, 1, 2**40])
def test_sobol_is_a_net_in_every_prefix_of_a_power_of_two(square: Distribution, seed: int) -> None:
    for bits in range(11):
        for split in range(max(0, bits - 6), min(bits, 6) + 1):
            assert (cells(square, 2**bits, "sobol", seed, 2**split, 2 ** (bits - split)) == 1).all()


def test_sobol_scrambles_are_owens_not_shifts(square: Distribution) -> None:
    # An exclusive-or, or a shift of a whole axis, keeps the distances between points; Owen scrambling does not.
    distances = set()
    for seed in range(8):
        pixel = square.sample(64, seed, "sobol").pixel
        distances.add(tuple(pixel[:, 0] ^ pixel[0, 0]))
    assert len(distances) == 8


@pytest.mark.parametrize(("count", "strips"), [(1, [1]), (4, [2, 2]), (7, [3, 2, 2]), (16, [4] * 4), (20, [5] * 4)])
def test_stratified_has_one_point_in_each_of_any_number_of_cells(
    square: Distribution, count: int, strips: list[int]
) -> None:
    for seed in range(30):
        x, y = square.sample(count, seed, "stratified").pixel.T
        first = 0
        for cells_in_strip in strips:
            inside = slice(first, first + cells_in_strip)
            low, high = first / count, (first + cells_in_strip) / count
            assert (np.abs((y[inside] + 0.5) / N - (low + high) / 2) <= (high - low) / 2 + 0.5 / N).all()
            column = (np.arange(cells_in_strip) + 0.5) / cells_in_strip
            assert (np.abs((x[inside] + 0.5) / N - column) <= 0.5 / cells_in_strip + 0.5 / N).all()
            first += cells_in_strip


def test_r2_is_the_lattice_of_the_plastic_number(square: Distribution) -> None:
    g = 1.3247179572447458
    x, y = square.sample(500, 3, "r2").pixel.T
    for values, step in ((x, 1 / g), (y, 1 / g**2)):
        offset = ((values + 0.5) / N - step * np.arange(500)) % 1
        spread = (offset - offset[0] + 0.5) % 1 - 0.5
        assert np.abs(spread).max() <= 1 / N + 1e-4


@pytest.mark.parametrize("count", [1, 2, 7, 16, 37, 64])
def test_a_lattice_has_one_point_in_each_of_n_parts_of_both_axes(square: Distribution, count: int) -> None:
    for seed in range(4):
        for values in square.sample(count, seed, "lattice").pixel.T:
            gaps = np.sort(values) - N / count * np.arange(count)
            assert np.ptp(gaps) <= 1
            if N % count == 0:
                assert (np.bincount(values * count // N) == 1).all()


@pytest.mark.parametrize("n", [1, 2, 3, 35, 64, 97, 100])
def test_the_figure_of_merit_is_the_least_product_of_dual_frequencies(n: int) -> None:
    prime_to_n = np.array([g for g in range(1, n + 1) if math.gcd(g, n) == 1])
    k = np.arange(1, n)
    expected = [min(k * np.minimum(g * k % n, -g * k % n), default=n) for g in prime_to_n.tolist()]
    np.testing.assert_array_equal(figure_of_merit(n, prime_to_n), expected)
    assert figure_of_merit(n, np.array([generator(n)])) == max(expected)


@pytest.mark.parametrize("n", [1025, 10_000, 2**20, 2**20 + 7, 2**31 - 1])
def test_a_lattice_of_many_points_has_a_good_generator(n: int) -> None:
    assert math.gcd(generator(n), n) == 1
    assert 1 < generator(n) < n
    assert figure_of_merit(n, np.array([generator(n)])) > n / 8  # the best generator has up to 0.38 n


@pytest.mark.slow
def test_the_generator_of_pixels_lattices_is_the_one_that_the_search_finds() -> None:
    search = run_path(str(ROOT / "docs" / "lattice.py"))["search"]
    kernel = (ROOT / "clkernels" / "rendering" / "pixel_block.clh").read_text()
    (used,) = re.findall(r"#define LATTICE_GENERATOR (\d+)u", kernel)
    assert int(used) in search()


def test_better_sequences_have_less_error(device: Device) -> None:
    from lightdome.lighting.exact import exact
    from lightdome.lighting.shade import shade_samples

    rng = np.random.default_rng(4)
    envmap = EnvironmentMap(np.exp(rng.normal(0, 1, (16, 32, 3))).repeat(4, 0).repeat(4, 1).astype(np.float32))
    distribution, target = build_distribution(device, envmap), exact(device, envmap, 33)
    error = {
        sequence: np.mean(
            [
                reference.relative_rmse(shade_samples(device, distribution.sample(256, s, sequence), 33), target)
                for s in range(10)
            ]
        )
        for sequence in SEQUENCES
    }
    for sequence in SEQUENCES[1:]:
        assert error[sequence] < 0.8 * error["independent"]


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_every_half_of_a_seed_counts(square: Distribution, sequence: str) -> None:
    drawn = {square.sample(64, seed, sequence).pixel.tobytes() for seed in (0, 1, 2**31, 2**32, 2**32 + 1, 2**63)}
    assert len(drawn) == 6
