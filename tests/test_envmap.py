"""Maps are checked before they are used, and pixels lie where the conventions say."""

from __future__ import annotations

import numpy as np
import pytest
from lightdome import reference
from lightdome.envmap import EnvironmentMap, solid_angles
from lightdome.errors import LightdomeError


def test_solid_angles_are_the_integrals_over_the_pixels() -> None:
    for height, width in ((1, 1), (2, 5), (512, 1024)):
        expected = reference.pixel_solid_angles(height, width)
        np.testing.assert_allclose(solid_angles(height, width), expected[:, 0], rtol=1e-10)
        assert solid_angles(height, width).sum() * width == pytest.approx(4 * np.pi, rel=1e-12)


def test_bad_pixels_are_counted_and_the_first_is_named() -> None:
    radiance = np.ones((4, 8, 3), np.float32)
    radiance[1, 6, 1] = np.nan
    radiance[2, 3] = np.inf
    radiance[3, 0, 2] = -1
    with pytest.raises(LightdomeError) as error:
        EnvironmentMap(radiance)
    for part in ("3 bad pixels", "1 NaN", "1 infinite", "1 negative", "x = 6, y = 1", "--sanitize"):
        assert part in str(error.value)
    mended = EnvironmentMap(radiance, sanitize=True).radiance
    np.testing.assert_array_equal(mended[1, 6], [1, 0, 1])
    assert np.isnan(radiance[1, 6, 1])  # the caller's array is left alone
    assert mended.sum() == radiance[np.isfinite(radiance) & (radiance > 0)].sum()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, -1e-45])
def test_a_single_bad_value_is_seen(bad: float) -> None:
    radiance = np.zeros((4, 8, 3), np.float32)
    radiance[2, 5, 2] = bad
    with pytest.raises(LightdomeError, match="1 bad pixel"):
        EnvironmentMap(radiance)


@pytest.mark.parametrize("shape", [(4, 8), (4, 8, 4), (0, 8, 3)])
def test_other_shapes_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(LightdomeError, match="shape"):
        EnvironmentMap(np.zeros(shape, np.float32))


def test_a_map_that_is_not_two_to_one_has_a_note() -> None:
    assert EnvironmentMap(np.ones((4, 8, 3))).shape_note is None
    assert "7 x 4" in (EnvironmentMap(np.ones((4, 7, 3))).shape_note or "")
