"""Markers are squares around their pixels, and large ones cost no more than small ones."""

from __future__ import annotations

import time

import numpy as np
import pytest
from lightdome.maps.markers import mark_picture, mark_pixels


def test_markers_wrap_at_the_sides_and_are_clipped_at_the_poles() -> None:
    image = np.zeros((6, 8, 3))
    mark_pixels(image, np.array([[0, 0], [7, 5]]), 3, (0, 0, 1))
    expected = np.zeros((6, 8), bool)
    expected[np.ix_([0, 1], [7, 0, 1])] = True
    expected[np.ix_([4, 5], [6, 7, 0])] = True
    np.testing.assert_array_equal(image[..., 2], expected)
    assert not image[..., :2].any()


@pytest.mark.parametrize("size", [1, 2, 5])
def test_markers_on_pictures_are_blue_with_a_white_outline(size: int) -> None:
    picture = np.full((12, 20, 3), 7, np.uint8)
    pixel = np.array([[0, 4], [10, 11], [11, 5], [13, 5]])  # over the edge, clipped, and two that touch
    plain = picture.astype(float)
    mark_pixels(plain, pixel, size, (0, 0, 1))
    mark_picture(picture, pixel, size)
    blue = (plain == (0, 0, 1)).all(axis=2)
    np.testing.assert_array_equal((picture == (0, 0, 255)).all(axis=2), blue)
    around = np.zeros_like(blue)
    for y, x in np.argwhere(blue):
        around[max(y - 1, 0) : y + 2, np.arange(x - 1, x + 2) % 20] = True
    np.testing.assert_array_equal((picture == 255).all(axis=2), around & ~blue)
    assert (picture[~around] == 7).all()


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (6, 8), (7, 12)])
@pytest.mark.parametrize("size", [1, 2, 3, 4, 6, 7, 8, 11, 12, 13, 24, 2**31 - 1])
def test_markers_of_any_size_are_squares_round_their_pixels(shape: tuple[int, int], size: int) -> None:
    height, width = shape
    rng = np.random.default_rng(height * 31 + size)
    pixel = np.stack([rng.integers(0, n, 3) for n in (width, height)], axis=1)
    image = np.zeros((height, width, 3))
    mark_pixels(image, pixel, size, (0, 0, 1))
    expected = np.zeros(shape, bool)
    for x, y in pixel:
        across, down = (range(-min((size - 1) // 2, n), min(size // 2, n) + 1) for n in (width, height))
        rows = [y + d for d in down if 0 <= y + d < height]
        expected[np.ix_(rows, sorted({(x + d) % width for d in across}))] = True
    np.testing.assert_array_equal(image[..., 2] == 1, expected)


def test_a_large_marker_takes_no_longer_than_a_small_one() -> None:
    image = np.zeros((1024, 2048, 3), np.float32)
    pixel = np.stack([np.arange(2_000_000) % 2048, np.arange(2_000_000) % 1024], axis=1)

    def seconds(size: int) -> float:
        start = time.perf_counter()
        mark_pixels(image, pixel, size, (0, 0, 1))
        return time.perf_counter() - start

    assert max(seconds(3000), seconds(2**31 - 1)) < 5 * seconds(3) + 0.5
