"""Samples follow luminance x sin(theta), to the last pixel and the last digit."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from helpers import stiff_radiance
from lightdome import reference
from lightdome.errors import LightdomeError
from lightdome.evaluation.stability import chi_square_z
from lightdome.maps.envmap import EnvironmentMap
from lightdome.opencl import memory
from lightdome.opencl.device import Device
from lightdome.sampling.cdf import build_row_cdfs
from lightdome.sampling.device_map import DeviceMap
from lightdome.sampling.distribution import Distribution, build_distribution
from lightdome.sampling.draw import is_guided
from lightdome.sampling.guide import build_guide
from lightdome.sampling.samples import SEQUENCES, Samples

SHAPES = [(1, 1), (1, 40), (40, 1), (2, 2), (15, 31), (16, 32), (17, 33), (64, 100), (9, 277)]


def of_strips(rows: np.ndarray) -> list[np.ndarray]:
    """The columns of each strip."""
    return np.split(rows, reference.strip_borders(rows.shape[1])[1:-1], axis=1)


def counts(samples: Samples) -> np.ndarray:
    height, width = samples.map_shape
    index = samples.pixel[:, 1].astype(np.int64) * width + samples.pixel[:, 0]
    return np.bincount(index, minlength=height * width).reshape(height, width)


@pytest.mark.parametrize("shape", SHAPES)
def test_probability_and_flux_meet_the_reference(device: Device, shape: tuple[int, int]) -> None:
    radiance = stiff_radiance(*shape)
    radiance[0, 0] = 1
    distribution = build_distribution(device, EnvironmentMap(radiance))
    samples = distribution.sample(5000)
    x, y = samples.pixel.T
    np.testing.assert_allclose(samples.probability, reference.probability(radiance)[y, x], rtol=1e-6)
    assert distribution.flux == pytest.approx(reference.flux(radiance), rel=1e-6)


def test_direction_radiance_and_pixel_agree(device: Device, stiff: EnvironmentMap) -> None:
    samples = build_distribution(device, stiff).sample(5000)
    x, y = samples.pixel.T
    np.testing.assert_array_equal(samples.radiance, stiff.radiance[y, x])
    directions = reference.directions(stiff.height, stiff.width)[y, x]
    np.testing.assert_allclose(samples.direction, directions, atol=2e-7)
    p = reference.probability(stiff.radiance)[y, x]
    density = p / reference.pixel_solid_angles(stiff.height, stiff.width)[y, x]
    np.testing.assert_allclose(samples.density, density, rtol=1e-6)


@pytest.mark.parametrize("shape", SHAPES)
def test_cdfs_are_monotone_and_steps_are_the_weights(device: Device, shape: tuple[int, int]) -> None:
    radiance = stiff_radiance(*shape)
    distribution = build_distribution(device, EnvironmentMap(radiance))
    rows = memory.download(device, distribution.cdf.rows).astype(np.int64)
    weights = reference.luminance(radiance)
    g = reference.probability(radiance)
    over_rows = memory.download(device, distribution.cdf.marginal).astype(np.int64)
    for cdf, weight, share, of_rows in zip(*map(of_strips, (rows, weights, g)), over_rows, strict=True):
        for one, of_step in ((cdf, weight), (of_rows[None], share.sum(axis=1)[None])):
            steps = np.diff(one, prepend=0, axis=1)
            assert (steps >= 0).all()
            assert (steps[of_step == 0] == 0).all()
            lit = of_step.sum(axis=1) > 0
            assert (one[lit, -1] >= 2**30 - one.shape[1]).all()
            expected = of_step[lit] / of_step[lit].sum(axis=1, keepdims=True)
            np.testing.assert_allclose(steps[lit] / one[lit, -1:], expected, atol=2.0**-30, rtol=1e-6)


@pytest.mark.parametrize("width", [1, 2, 15, 16, 17, 31, 32, 33, 48, 100, 255, 1000])
@pytest.mark.parametrize(("scale", "offset"), [(1.0, 0.0), (2.0**-3, 0.0), (2.0**-3, 0.7)])
def test_a_row_cdf_is_the_exact_sum_of_rounded_weights(device: Device, width: int, scale: float, offset: float) -> None:
    radiance = stiff_radiance(8, width)
    radiance[0] *= np.float32(2.0**100)
    radiance[2] *= np.float32(2.0**-105)  # 2^k is above the largest float32
    radiance[4] *= np.float32(2.0**-140)  # the sum is subnormal
    of_map = replace(DeviceMap.of(device, EnvironmentMap(radiance)), scale=scale)
    built = build_row_cdfs(of_map, offset)
    cdfs, row_sums = memory.download(device, built.cdf), memory.download(device, built.sums)

    r, g, b = np.moveaxis(radiance * np.float32(scale), 2, 0)
    weights = np.maximum(r + g + b - np.float32(offset), 0)
    for cdf, row_sum, weight in zip(of_strips(cdfs), row_sums, of_strips(weights), strict=True):
        sums = np.array([math.fsum(row) for row in weight])
        np.testing.assert_allclose(row_sum.astype(np.float64).sum(axis=1), sums, rtol=1e-13)
        k = 31 - np.frexp(sums.astype(np.float32))[1]
        q = np.ldexp(weight, k[:, None]) + np.float32(0.5)
        np.testing.assert_array_equal(cdf, np.where(sums[:, None] > 0, q.astype(np.int64), 0).cumsum(axis=1))


def test_a_million_draws_pass_chi_square_and_only_with_sin_theta(device: Device, stiff: EnvironmentMap) -> None:
    seen = counts(build_distribution(device, stiff).sample(1_000_000))
    assert abs(chi_square_z(seen, reference.probability(stiff.radiance))) < 4
    without = reference.luminance(stiff.radiance)
    assert chi_square_z(seen, without / without.sum()) > 100


def test_a_pixel_of_weight_zero_is_never_drawn(device: Device, stiff: EnvironmentMap) -> None:
    seen = counts(build_distribution(device, stiff).sample(1_000_000, seed=5))
    assert seen[reference.luminance(stiff.radiance) == 0].sum() == 0


@pytest.mark.parametrize("lit", [(0, 0), (0, 42), (10, 20), (20, 0), (20, 42)])
def test_a_single_lit_pixel_is_always_drawn(device: Device, lit: tuple[int, int]) -> None:
    radiance = np.zeros((21, 43, 3), np.float32)
    radiance[lit] = (0, 0, 1e-30)
    ends = np.array([0, 0.5, 1 - 2.0**-24, 1 - 2.0**-32, np.nextafter(1, 0)])
    points = np.stack(np.meshgrid(ends, ends), axis=-1).reshape(-1, 2)
    samples = build_distribution(device, EnvironmentMap(radiance)).sample_at(points)
    assert (samples.pixel == (lit[1], lit[0])).all()
    np.testing.assert_allclose(samples.probability, 1, rtol=1e-6)


@pytest.mark.parametrize("width", [31, 43, 300])
def test_points_pick_the_pixels_of_the_textbook(device: Device, width: int) -> None:
    radiance = stiff_radiance(21, width)
    points = np.random.default_rng(3).random((2000, 2))
    picked = build_distribution(device, EnvironmentMap(radiance)).sample_at(points).pixel
    expected = reference.invert(radiance, points)
    # A point within 2^-29 of a step of the CDF may fall on either side.
    assert (picked == expected).all(axis=1).mean() > 0.999


def test_every_edge_of_a_cdf_is_exact(device: Device) -> None:
    radiance = np.ones((2, 8, 3), np.float32)
    distribution = build_distribution(device, EnvironmentMap(radiance))
    edges = np.arange(8) / 8
    below = edges[1:] - 2.0**-32
    for u, expected in ((edges, np.arange(8)), (below, np.arange(7))):
        points = np.stack([u, np.full_like(u, 0.25)], axis=1)
        np.testing.assert_array_equal(distribution.sample_at(points).pixel[:, 0], expected)


def test_the_same_seed_gives_the_same_samples_everywhere(device: Device) -> None:
    # Recorded once. A device, version or change that draws other samples breaks every user's files.
    y, x, c = np.mgrid[0:64, 0:128, 0:3]
    envmap = EnvironmentMap(((x * 7 + y * 13 + c * 5) % 31).astype(np.float32))
    samples = build_distribution(device, envmap).sample(6, seed=0x123456789ABCDEF)
    assert samples.pixel.tolist() == RECORDED_PIXELS
    assert samples.probability.view(np.uint32).tolist() == RECORDED_BITS


RECORDED_PIXELS = [[92, 43], [10, 31], [86, 24], [50, 40], [124, 32], [40, 13]]
RECORDED_BITS = [962506722, 959327685, 964302402, 950765914, 963718062, 958720354]


def philox(counter: list[int], key: list[int]) -> list[int]:
    """Philox 4x32-10, from the paper (Salmon et al. 2011, section 3.3)."""
    c, k = list(counter), list(key)
    for _ in range(10):
        a, b = 0xD2511F53 * c[0], 0xCD9E8D57 * c[2]
        c = [(b >> 32) ^ c[1] ^ k[0], b & 0xFFFFFFFF, (a >> 32) ^ c[3] ^ k[1], a & 0xFFFFFFFF]
        k = [(k[0] + 0x9E3779B9) & 0xFFFFFFFF, (k[1] + 0xBB67AE85) & 0xFFFFFFFF]
    return c


def test_independent_points_are_philox(device: Device, stiff: EnvironmentMap) -> None:
    assert philox([0] * 4, [0] * 2) == [0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8]  # known answer
    points = np.array([philox([i, 0, 0, 0], [7, 9]) for i in range(250)]).reshape(500, 2) / 2**32
    distribution = build_distribution(device, stiff)
    drawn = distribution.sample(499, seed=7 + (9 << 32)).pixel
    np.testing.assert_array_equal(drawn, distribution.sample_at(points).pixel[:499])


def test_seeds_differ_and_fewer_samples_are_a_prefix(device: Device, stiff: EnvironmentMap) -> None:
    distribution = build_distribution(device, stiff)
    pixels = distribution.sample(100, seed=1).pixel
    np.testing.assert_array_equal(distribution.sample(10, seed=1).pixel, pixels[:10])
    assert (distribution.sample(100, seed=2).pixel != pixels).any()
    assert (distribution.sample(100, seed=1 + 2**32).pixel != pixels).any()


@pytest.mark.parametrize("factor", [2.0**-140, 2.0**-100, 2.0**100])
def test_the_ends_of_float32_draw_the_same_pixels(device: Device, factor: float) -> None:
    radiance = np.random.default_rng(2).integers(1, 100, (20, 40, 3)).astype(np.float32)
    plain = build_distribution(device, EnvironmentMap(radiance)).sample(1000)
    scaled = build_distribution(device, EnvironmentMap(radiance * np.float32(factor))).sample(1000)
    np.testing.assert_array_equal(scaled.pixel, plain.pixel)
    np.testing.assert_array_equal(scaled.probability, plain.probability)


def test_a_bright_pixel_does_not_spoil_its_neighbours(device: Device) -> None:
    radiance = np.ones((32, 64, 3), np.float32)
    radiance[16, 30] = 1e12
    samples = build_distribution(device, EnvironmentMap(radiance)).sample_at(
        np.stack([np.linspace(0, 1, 999, endpoint=False), np.linspace(0, 1, 999, endpoint=False)], axis=1)
    )
    x, y = samples.pixel.T
    np.testing.assert_allclose(samples.probability, reference.probability(radiance)[y, x], rtol=1e-6)


def too_few(distribution: Distribution) -> int:
    """The most samples that are drawn without guide tables."""
    of_map = distribution.map
    count = math.ceil(of_map.width * of_map.height / 8) - 1
    assert is_guided(count + 1, of_map)
    assert not is_guided(count, of_map)
    return count


@pytest.mark.parametrize("shape", [(1, 9), (9, 1), (21, 43), (5, 300), (64, 128), (33, 31)])
def test_guided_searches_end_where_plain_ones_do(device: Device, shape: tuple[int, int]) -> None:
    distribution = build_distribution(device, EnvironmentMap(stiff_radiance(*shape) + np.float32(1e-30)))
    cdf = memory.download(device, distribution.cdf.rows).astype(np.float64)[shape[0] // 2]
    first, *_ = (memory.download(device, distribution.cdf.strips) / 2.0**32).T
    strips = zip(of_strips(cdf[None]), first, np.diff(first, append=1), strict=True)
    edges = np.concatenate([begin + size * (of_strip[0] / of_strip[0, -1])[:-1] for of_strip, begin, size in strips])
    ends = np.concatenate([edges, edges - 2.0**-32, edges + 2.0**-32, [0, 1 - 2.0**-32]]).clip(0, 1 - 2.0**-32)
    few = too_few(distribution)
    points = np.random.default_rng(0).random((min(100 * few, 5000), 2))
    points[: len(ends), 0] = ends
    points[: len(ends), 1] = (shape[0] // 2 + 0.5) / shape[0]
    guided = distribution.sample_at(points)
    for first in range(0, len(points), few):
        some = slice(first, first + few)
        plain = distribution.sample_at(points[some])
        for name in ("pixel", "probability", "direction", "radiance"):
            np.testing.assert_array_equal(getattr(guided, name)[some], getattr(plain, name))


def test_a_point_on_a_step_within_a_bucket_finds_the_next_pixel(device: Device) -> None:
    radiance = np.ones((1, 64, 3), np.float32)
    radiance[0, ::2] = 3  # steps at whole 128ths, every other step in the middle of a bucket of the guide table
    edges = np.cumsum(radiance[0, :, 0], dtype=np.float64)[:-1] / 128
    points = np.stack([np.concatenate([edges, edges - 2.0**-32]), np.zeros(126)], axis=1)
    envmap = EnvironmentMap(radiance)
    distribution = build_distribution(device, envmap)
    assert len(points) > too_few(distribution)
    x = distribution.sample_at(points).pixel[:, 0]
    np.testing.assert_array_equal(x, np.concatenate([np.arange(1, 64), np.arange(63)]))


@pytest.mark.parametrize("guided", [True, False])
def test_pixels_alone_are_those_of_samples(device: Device, stiff: EnvironmentMap, guided: bool) -> None:
    distribution = build_distribution(device, stiff)
    count = 777 if guided else too_few(distribution)
    for sequence in SEQUENCES:
        samples = distribution.sample(count, 5, sequence)
        pixel, probability = distribution.sample_pixels(count, 5, sequence)
        np.testing.assert_array_equal(pixel, samples.pixel)
        np.testing.assert_array_equal(probability, samples.probability)


def test_large_maps_have_fewer_buckets(device: Device, stiff: EnvironmentMap) -> None:
    distribution = build_distribution(device, stiff)
    plain = distribution.sample(100_000)
    cdf = replace(distribution.cdf)
    guide = vars(cdf)["guide"] = build_guide(device, cdf.rows, cdf.marginal, max_buckets=300)
    assert guide.rows.shape[1] <= 2 * 300 / stiff.height
    np.testing.assert_array_equal(replace(distribution, cdf=cdf).sample(100_000).pixel, plain.pixel)


def test_maps_wider_than_16_bits_are_guided_too(device: Device) -> None:
    distribution = build_distribution(device, EnvironmentMap(stiff_radiance(3, 70000)))
    few = too_few(distribution)
    np.testing.assert_array_equal(distribution.sample(few + 1).pixel[:few], distribution.sample(few).pixel)


def test_mistakes_are_reported(device: Device, stiff: EnvironmentMap) -> None:
    distribution = build_distribution(device, stiff)
    with pytest.raises(LightdomeError, match="got 0"):
        distribution.sample(0)
    with pytest.raises(LightdomeError, match="seed"):
        distribution.sample(1, seed=-1)
    with pytest.raises(LightdomeError, match="sequence"):
        distribution.sample(1, sequence="magic")
    with pytest.raises(LightdomeError, match=r"\[0, 1\)"):
        distribution.sample_at(np.array([[0.5, 1.0]]))
    with pytest.raises(LightdomeError, match="black"):
        build_distribution(device, EnvironmentMap(np.zeros((4, 8, 3)))).sample(1)


@pytest.mark.parametrize("peak", [2.0**-100, 1.0, 3e38])
def test_many_pixels_alone_probabilities_and_flux_are_right_on_any_scale(device: Device, peak: float) -> None:
    radiance = np.float32(peak) * np.random.default_rng(0).random((21, 43, 3), np.float32)
    distribution = build_distribution(device, EnvironmentMap(radiance))
    assert distribution.flux == pytest.approx(reference.flux(radiance), rel=1e-6)
    samples = distribution.sample(2000, 5)
    pixel, probability = distribution.sample_pixels(2000, 5)
    np.testing.assert_array_equal(pixel, samples.pixel)
    np.testing.assert_array_equal(probability, samples.probability)
    np.testing.assert_allclose(probability, reference.probability(radiance)[pixel[:, 1], pixel[:, 0]], rtol=2e-6)


def test_samples_know_what_drew_them(device: Device, stiff: EnvironmentMap) -> None:
    distribution = build_distribution(device, stiff)
    for seed, sequence in zip((0, 7, 2**40, 2**63, 2**64 - 1), SEQUENCES, strict=True):
        samples = distribution.sample(3, seed, sequence)
        assert (samples.seed, samples.sequence, samples.map_shape) == (seed, sequence, (21, 43))
        np.testing.assert_array_equal(distribution.sample(3, samples.seed, samples.sequence).pixel, samples.pixel)


@pytest.mark.parametrize("shape", [(1, 7), (37, 61), (499, 17), (17, 3001)])
def test_the_flux_keeps_what_lies_far_below_the_total(device: Device, shape: tuple[int, int]) -> None:
    # Small integers times powers of two, so that the expected sum is exact; a sun is 2^33 times the least.
    rng = np.random.default_rng(shape[1])
    radiance = np.ldexp(rng.integers(1, 8, (*shape, 3)), rng.integers(-30, 0, (*shape, 1))).astype(np.float32)
    radiance[shape[0] // 2, 3] = 8
    distribution = build_distribution(device, EnvironmentMap(radiance))
    sine = np.sin(np.pi / shape[0] * (np.arange(shape[0]) + 0.5)).astype(np.float32).astype(np.float64)
    expected = math.fsum((radiance.sum(axis=2, dtype=np.float64) * sine[:, None]).ravel())
    assert distribution.total == pytest.approx(expected, rel=1e-12)
