"""Maps are checked before they are used, and pixels lie where the conventions say."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import ROOT, stiff_radiance
from lightdome import reference
from lightdome.disc import disc_mask
from lightdome.errors import LightdomeError
from lightdome.lighting.exact import exact
from lightdome.lighting.harmonics import Harmonics, project, shade_harmonics
from lightdome.lighting.lights import Lights
from lightdome.lighting.median_cut import median_cut
from lightdome.lighting.shade import shade_samples
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.geometry import solid_angles
from lightdome.maps.images import read_image, write_image
from lightdome.opencl.device import Device
from lightdome.rendering.per_pixel import ESTIMATORS, render
from lightdome.sampling.distribution import build_distribution
from lightdome.sampling.samples import Samples

SUN = ROOT / "tests" / "maps" / "field_cases" / "exr_half_infinite_sun.exr"
LARGEST = np.finfo(np.float32).max


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
    for part in ("3 bad pixels", "1 NaN", "1 infinite", "1 negative", "x = 6, y = 1", "--sanitize", "--sanitize clamp"):
        assert part in str(error.value)
    mended = EnvironmentMap(radiance, sanitize=True).radiance
    np.testing.assert_array_equal(mended[1, 6], [1, 0, 1])
    assert np.isnan(radiance[1, 6, 1])  # the caller's array is unchanged
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


def test_a_clamp_is_offered_only_where_there_is_an_infinity() -> None:
    with pytest.raises(LightdomeError, match=r"black with --sanitize$"):
        EnvironmentMap(np.full((2, 4, 3), -np.inf, np.float32))


@pytest.mark.parametrize(
    ("kind", "largest"), [(np.float16, 65504.0), (np.float32, LARGEST), (np.float64, LARGEST), (">f4", LARGEST)]
)
def test_a_clamp_makes_infinities_the_largest_value_of_the_type(kind: str, largest: float) -> None:
    radiance = np.ones((4, 8, 3), kind)
    radiance[1, 6] = np.inf, 2, np.inf
    radiance[2, 3, 0] = np.nan
    radiance[3, 0] = -1, -np.inf, 5
    expected = radiance.astype(np.float32)
    expected[1, 6] = largest, 2, largest
    expected[2, 3, 0] = 0
    expected[3, 0] = 0, 0, 5
    envmap = EnvironmentMap(radiance, sanitize="clamp")
    np.testing.assert_array_equal(envmap.radiance, expected)
    assert envmap.peak == largest


@pytest.mark.parametrize("way", ["black", "clamp"])
def test_what_was_replaced_is_reported_with_the_flux_that_it_carries(way: str) -> None:
    radiance = stiff_radiance(6, 12) + np.float32(1)
    radiance[1, 6] = np.inf
    radiance[2, 3, 0] = np.nan
    radiance[3, 0, 1] = radiance[3, 0, 2] = -np.inf
    radiance[3, 1] = np.inf, -1, np.nan
    bad = ~(np.isfinite(radiance) & (radiance >= 0)).all(axis=2)
    envmap = EnvironmentMap(radiance, sanitize=way)
    light = reference.luminance(envmap.radiance) * reference.pixel_solid_angles(6, 12)
    share = light[bad].sum() / light.sum()
    found = envmap.replaced
    assert (found.pixels, found.nan, found.infinite, found.negative) == (4, 2, 2, 2)
    assert found.flux_share == pytest.approx(share, rel=1e-9)
    assert (share > 0.999) == (way == "clamp")
    value = "3.40282e+38" if way == "clamp" else "0"
    for words in ("4 bad pixels were replaced", "2 NaN by 0", f"2 infinite by {value}", "2 negative by 0", "%"):
        assert words in found.note
    assert f"{100 * share:.3g} % of the map's flux" in found.note
    assert EnvironmentMap(np.ones((2, 4, 3)), sanitize=way).replaced is None


def test_true_is_black_and_another_name_is_refused() -> None:
    radiance = np.full((2, 4, 3), np.inf)
    radiance[0] = 1
    np.testing.assert_array_equal(
        EnvironmentMap(radiance, sanitize=True).radiance, EnvironmentMap(radiance, sanitize="black").radiance
    )
    for name in ("white", "", 2, ["clamp"]):
        with pytest.raises(LightdomeError, match="'black' or 'clamp'"):
            EnvironmentMap(radiance, sanitize=name)


def test_a_clamp_keeps_the_sun_of_a_half_float_file(device: Device) -> None:
    with pytest.raises(LightdomeError, match=r"1 infinite.*--sanitize clamp"):
        EnvironmentMap.read(SUN)
    envmap = EnvironmentMap.read(SUN, sanitize="clamp")
    assert tuple(np.argwhere(envmap.radiance == 65504)[0]) == (2, 5, 0)
    assert envmap.replaced.flux_share > 0.9
    drawn = build_distribution(device, envmap).sample(200)
    assert (drawn.pixel == (5, 2)).all(axis=1).mean() > 0.9


def test_what_float_files_hold_is_clamped_to_float32s_largest(tmp_path: Path) -> None:
    radiance = stiff_radiance(4, 8)
    radiance[1, 2] = np.inf
    for name in ("map.exr", "map.pfm"):
        write_image(tmp_path / name, radiance)
        assert EnvironmentMap.read(tmp_path / name, sanitize="clamp").radiance[1, 2, 0] == LARGEST


def test_sums_of_clamped_pixels_stay_in_range(device: Device) -> None:
    radiance = stiff_radiance(16, 32)
    radiance[3:6, 4:12] = np.inf
    envmap = EnvironmentMap(radiance, sanitize="clamp")
    assert 0.999 < envmap.replaced.flux_share <= 1
    distribution = build_distribution(device, envmap)
    assert distribution.flux == pytest.approx(reference.flux(envmap.radiance), rel=1e-6)
    samples = distribution.sample(500)
    x, y = samples.pixel.T
    np.testing.assert_allclose(samples.probability, reference.probability(envmap.radiance)[y, x], rtol=1e-6)
    assert np.isfinite(samples.flux).all()
    expected = reference.exact(envmap.radiance, reference.normals(17)[disc_mask(17)], 0.1)
    truth = exact(device, envmap, 17, 0.1)
    np.testing.assert_allclose(truth[disc_mask(17)], np.minimum(expected, LARGEST), rtol=2e-6, atol=1e-6 * LARGEST)
    lights = median_cut(distribution, 16)
    np.testing.assert_allclose(lights.flux.sum() / 3, distribution.flux, rtol=1e-6)
    for image in (
        shade_samples(device, samples, 17, 0.1),
        shade_harmonics(device, project(device, envmap), 17, 0.1),
        *(next(render(distribution, [16], 17, 0.1, estimator=name))[1] for name in ESTIMATORS),
    ):
        assert np.isfinite(image).all()
        assert reference.relative_rmse(image, truth) < 1


# --- checked values do not change afterwards ---------------------------------------------------


def test_the_callers_array_is_not_the_maps() -> None:
    radiance = np.ones((4, 8, 3), np.float32)
    views = (radiance, radiance[:, ::-1], np.asfortranarray(radiance), np.broadcast_to(np.float32(1), (4, 8, 3)))
    maps = [EnvironmentMap(view) for view in views]
    frozen = radiance.copy()
    frozen.flags.writeable = False
    maps.append(EnvironmentMap(frozen))
    frozen.flags.writeable = True
    radiance[...] = frozen[...] = np.nan
    assert radiance.flags.writeable  # the caller may still write to it
    for envmap in maps:
        assert (envmap.radiance == 1).all()
        with pytest.raises(ValueError, match="read-only"):
            envmap.radiance[0, 0] = np.nan


def test_nothing_that_was_checked_can_be_written_to(device: Device, tmp_path: Path) -> None:
    write_image(tmp_path / "map.pfm", stiff_radiance(4, 8))
    envmap = EnvironmentMap.read(tmp_path / "map.pfm")
    distribution = build_distribution(device, envmap)
    samples = distribution.sample(6)
    samples.save(tmp_path / "samples.npz")
    lights, harmonics = median_cut(distribution, 3), project(device, envmap)
    for thing in (
        envmap,
        EnvironmentMap(np.full((2, 4, 3), np.nan), sanitize=True),
        samples,
        Samples.load(tmp_path / "samples.npz"),
        replace(samples, seed=3),
        distribution.sample_at(np.full((2, 2), 0.5)),
        lights,
        Lights.of(samples),
        Lights(lights.direction, lights.flux),
        harmonics,
        harmonics.truncated(1),
        Harmonics(harmonics.coefficients),
    ):
        arrays = [value for value in vars(thing).values() if isinstance(value, np.ndarray)]
        assert arrays
        for array in arrays:
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 0


def test_lights_samples_and_harmonics_have_arrays_of_their_own(device: Device) -> None:
    distribution = build_distribution(device, EnvironmentMap(stiff_radiance(4, 8)))
    direction, flux = np.array([[0, 1, 0]], np.float32), np.ones((1, 3))
    coefficients = np.ones((9, 3))
    drawn = distribution.sample(6)
    arrays = {name: getattr(drawn, name).copy() for name in ("direction", "radiance", "probability", "pixel")}
    lights, harmonics = Lights(direction, flux), Harmonics(coefficients)
    samples = Samples(**arrays, map_shape=(4, 8))
    for array in (direction, flux, coefficients, *arrays.values()):
        array[...] = 7
    assert (lights.direction == (0, 1, 0)).all()
    assert (lights.flux == 1).all()
    assert (harmonics.coefficients == 1).all()
    for name in arrays:
        np.testing.assert_array_equal(getattr(samples, name), getattr(drawn, name))


def test_a_map_that_is_read_is_not_copied(tmp_path: Path) -> None:
    radiance = stiff_radiance(64, 128)
    write_image(tmp_path / "map.exr", radiance)

    def allocated(read: Callable[[Path], object]) -> list[tracemalloc.Traceback]:
        """The lines of code that allocated memory as large as the map and kept it."""
        tracemalloc.start()
        kept = read(tmp_path / "map.exr")
        found = [trace.traceback for trace in tracemalloc.take_snapshot().traces if trace.size >= radiance.nbytes]
        tracemalloc.stop()
        del kept
        return found

    by_reader = allocated(read_image)
    assert len(by_reader) == 1
    assert allocated(EnvironmentMap.read) == by_reader


def test_flipped_rows_come_in_reverse(tmp_path: Path) -> None:
    radiance = stiff_radiance(5, 8)
    for name in ("map.pfm", "map.exr"):
        write_image(tmp_path / name, radiance)
        np.testing.assert_array_equal(EnvironmentMap.read(tmp_path / name, flip=True).radiance, radiance[::-1])
        np.testing.assert_array_equal(read_image(tmp_path / name, flip=True), radiance[::-1])


@pytest.mark.parametrize("at", [(0, 0), (0, 7), (3, 2)])
@pytest.mark.parametrize("channel", range(3))
def test_one_coloured_pixel_makes_a_map_coloured(at: tuple[int, int], channel: int) -> None:
    radiance = np.repeat(np.random.default_rng(0).random((4, 8, 1), np.float32), 3, axis=2)
    assert EnvironmentMap(radiance).is_grey
    radiance[(*at, channel)] += 1
    assert not EnvironmentMap(radiance).is_grey
