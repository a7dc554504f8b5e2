"""Vertical strips: which columns they have, how points pick them, and what points leave for the pixels in them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from helpers import stiff_radiance
from lightdome import reference
from lightdome.maps.envmap import EnvironmentMap
from lightdome.opencl import memory
from lightdome.opencl.device import Device
from lightdome.sampling.distribution import build_distribution
from lightdome.sampling.strips import strip_bits, strip_borders, strip_table

ALL = 2**32


@pytest.mark.parametrize("width", [*range(1, 300), 1000, 1024, 4097, 32768, 2**31 - 1])
def test_strips_are_of_nearly_equal_width_and_cover_the_map(width: int) -> None:
    borders = strip_borders(width)
    assert borders.tolist() == reference.strip_borders(width)
    assert len(borders) == (1 << strip_bits(width)) + 1
    assert (borders[0], borders[-1]) == (0, width)
    assert (borders[:-1] % 16 == 0).all()
    columns = np.diff(borders)
    assert columns.min() >= min(width, 16)
    assert columns.max() - columns.min() < 32


@pytest.mark.parametrize(
    "weights",
    [[1.0], [3.0, 1.0], [0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 2.0, 5.0], [1e30, 1.0, 1e30, 1.0], [0.1] * 8, [1e-30, 7e-30]],
)
def test_points_pick_strips_by_weight_and_leave_evenly_spread_rests(weights: list[float]) -> None:
    table = strip_table(np.array(weights)).astype(object)
    assert len(table) == len(weights)
    total = sum(weights)
    seen = set()
    for (first, high, low, strip), end in zip(table, [*table[1:, 0], ALL], strict=True):
        size = end - first
        if size == 0:  # a copy of the first entry
            continue
        seen.add(strip)
        assert abs(size - ALL * weights[strip] / total) <= 1
        inverse = high * ALL + low
        rests = [(point * inverse) >> 32 for point in {0, 1, size // 3, size - 1} if point < size]
        exact = [point * ALL // size for point in {0, 1, size // 3, size - 1} if point < size]
        assert all(0 <= rest < ALL and right - rest in (0, 1) for rest, right in zip(rests, exact, strict=True))
    assert seen == {strip for strip, weight in enumerate(weights) if ALL * weight / total > 0.5}
    assert table[0, 0] == 0


def test_no_points_pick_anything_on_a_black_map() -> None:
    assert strip_table(np.zeros(4)).tolist() == [[0, 1, 0, 0]] * 4


def test_all_points_are_left_as_they_are_by_a_single_strip(device: Device) -> None:
    envmap = EnvironmentMap(stiff_radiance(4, 31))
    assert memory.download(device, build_distribution(device, envmap).cdf.strips).tolist() == [[0, 1, 0, 0]]


@pytest.mark.parametrize("lit", [[0], [7], [3, 4], [1, 6]])
@pytest.mark.parametrize("within", ["centre", "pixel"])
def test_dark_strips_are_never_picked(device: Device, lit: list[int], within: str) -> None:
    radiance = np.zeros((16, 256, 3), np.float32)
    for strip in lit:
        radiance[:, 32 * strip : 32 * strip + 32] = 1
    distribution = build_distribution(device, EnvironmentMap(radiance))
    across = np.unique(np.concatenate([np.arange(256) / 256, (np.arange(256) + 1) / 256 - 2.0**-32]))
    points = np.stack(np.meshgrid(across, (np.arange(16) + 0.5) / 16), axis=-1).reshape(-1, 2)
    strips = distribution.sample_at(points, within).pixel[:, 0] // 32
    assert sorted(set(strips.tolist())) == lit
    assert np.bincount(strips)[lit].tolist() == [len(points) // len(lit)] * len(lit)


def test_neighbours_of_a_bright_strip_keep_all_their_pixels(device: Device) -> None:
    """Each strip's part of a row has a CDF of its own, which resolves it beside a pixel 1e12 times brighter."""
    radiance = np.ones((8, 256, 3), np.float32)
    radiance[3, 40] = 1e12
    cdf = memory.download(device, build_distribution(device, EnvironmentMap(radiance)).cdf.rows).astype(np.int64)
    for strip, (begin, end) in enumerate(pairwise(strip_borders(256))):
        steps = np.diff(cdf[3, begin:end], prepend=0)
        assert (steps > 0).all() == (strip != 1)


@pytest.mark.parametrize("size", [37, 48, 64, 1000])
def test_places_in_pixels_are_even_in_a_strip_of_few_points(device: Device, size: int) -> None:
    radiance = np.ones((1, 32, 3), np.float32)
    radiance[0, :16] = (2.0**32 - size) / size
    distribution = build_distribution(device, EnvironmentMap(radiance))
    first = int(memory.download(device, distribution.cdf.strips)[1, 0])
    assert abs(ALL - first - size) <= 16  # float32 rounds the bright pixels' sum
    further = (np.arange(64) + 0.5) / 64
    across = ((np.arange(first, ALL)[:, None] + further) / ALL).ravel()
    samples = distribution.sample_at(np.stack([across, np.full_like(across, 0.5)], axis=1), within="pixel")
    x = samples.pixel[:, 0]
    assert (np.diff(x) >= 0).all()
    counts = np.bincount(x, minlength=32)
    assert (counts[:16] == 0).all()
    assert np.ptp(counts[16:]) <= 2 * 64
    w_x, _, w_z = samples.direction.T
    place = np.arctan2(w_z, w_x) % (2 * np.pi) / (2 * np.pi) * 32 - x
    expected = np.concatenate([(np.arange(count) + 0.5) / count for count in counts if count])
    np.testing.assert_allclose(place, expected, atol=2e-5)
