"""The analysis of a map is correct: for made maps with known answers, by float64 equations, and by sampling."""

from __future__ import annotations

import json
import tracemalloc
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest
from helpers import stiff_radiance
from lightdome import reference
from lightdome.disc import disc_mask
from lightdome.errors import LightdomeError
from lightdome.evaluation.metrics import relative_rmse
from lightdome.lighting.exact import exact
from lightdome.lighting.shade import shade_samples
from lightdome.maps import analyse, images, split_sun
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.images import write_image
from lightdome.opencl.device import Device
from lightdome.sampling.distribution import build_distribution

ROWS = 256
FLUX = np.array([3.0, 2.8, 2.5])


def unit(azimuth: float, elevation: float) -> np.ndarray:
    phi, up = np.radians([azimuth, elevation])
    return np.array([np.cos(up) * np.cos(phi), np.sin(up), np.cos(up) * np.sin(phi)])


def angle(direction: np.ndarray, other: np.ndarray) -> np.ndarray:
    """The angle in degrees."""
    return np.degrees(2 * np.arcsin(np.linalg.norm(direction - other, axis=-1) / 2))


def sky(rows: int = ROWS) -> np.ndarray:
    """A blue gradient over dark ground."""
    up = np.cos(reference.angles(rows, 2 * rows)[0])[..., None]
    above = np.array([0.8, 0.8, 0.75]) * (1 - up) + np.array([0.3, 0.45, 0.8]) * up
    return np.where(up > 0, above, [0.12, 0.10, 0.08])


def disc(azimuth: float, elevation: float, radius: float, rows: int = ROWS, fine: int = 9) -> np.ndarray:
    """A sun that darkens towards its limb, (rows, 2 rows): means over each pixel, with a flux of 1."""
    inside = (np.arange(fine) + 0.5) / fine - 0.5
    theta, phi = reference.angles(rows, 2 * rows)
    result = np.zeros(theta.shape)
    for y in np.flatnonzero(np.abs(theta[:, 0] - np.radians(90 - elevation)) < np.radians(radius) + 2 * np.pi / rows):
        t = theta[y, 0] + inside[:, None, None] * np.pi / rows
        p = phi[0][:, None] + inside * np.pi / rows
        direction = np.stack(np.broadcast_arrays(np.sin(t) * np.cos(p), np.cos(t), np.sin(t) * np.sin(p)), axis=-1)
        off = angle(direction, unit(azimuth, elevation)) / radius
        light = np.where(off < 1, 0.4 + 0.6 * np.sqrt(np.maximum(0, 1 - off**2)), 0)
        result[y] = (light * np.sin(t)).mean(axis=(0, 2)) / np.sin(theta[y, 0])
    return result / (result * reference.pixel_solid_angles(*result.shape)).sum()


def under_sun(azimuth: float, elevation: float, radius: float, rows: int = ROWS) -> np.ndarray:
    return sky(rows) + disc(azimuth, elevation, radius, rows)[..., None] * FLUX


def test_every_number_is_that_of_its_definition() -> None:
    for radiance in (stiff_radiance(21, 43), stiff_radiance(130, 200, 2), sky(41).astype(np.float32)):
        found = analyse(radiance)
        height, width = radiance.shape[:2]
        light = radiance.astype(np.float64)
        solid_angle = reference.pixel_solid_angles(height, width)
        direction = reference.directions(height, width)
        luminance = reference.luminance(radiance)

        order = np.argsort(luminance, axis=None)
        below = np.cumsum(solid_angle.ravel()[order]) / (4 * np.pi)
        for name, share in (("median", 0.5), ("99_percent", 0.99), ("99_9_percent", 0.999)):
            expected = luminance.ravel()[order][np.searchsorted(below, share)]
            assert getattr(found, f"luminance_{name}_by_solid_angle") == np.float32(expected), name
        dark = below[np.count_nonzero(luminance == 0) - 1] if (luminance == 0).any() else 0
        darkest = luminance.ravel()[order][np.searchsorted(below, dark + 0.01 * (1 - dark))]
        assert found.range_stops == pytest.approx(np.log2(luminance.max() / darkest), rel=1e-6)
        assert found.luminance_minimum == np.float32(luminance.min())
        assert found.luminance_maximum == np.float32(luminance.max())

        flux = np.einsum("yx,yxc->c", solid_angle, light)
        assert found.flux_rgb_radiance_sr == pytest.approx(flux, rel=1e-12)
        assert found.mean_radiance_rgb == pytest.approx(flux / (4 * np.pi), rel=1e-12)
        for name, normal in {
            "up": (0, 1, 0),
            "down": (0, -1, 0),
            "plus_x": (1, 0, 0),
            "minus_x": (-1, 0, 0),
            "plus_z": (0, 0, 1),
            "minus_z": (0, 0, -1),
        }.items():
            expected = np.pi * reference.exact(radiance, np.array([normal], float))[0]
            assert getattr(found, f"irradiance_{name}_rgb_radiance_sr") == pytest.approx(expected, rel=1e-12), name

        p = (luminance * solid_angle).ravel() / (luminance * solid_angle).sum()
        vector = p @ direction.reshape(-1, 3)
        assert found.mean_direction_length == pytest.approx(np.linalg.norm(vector), rel=1e-9)
        mean = unit(found.mean_direction_azimuth_degrees, found.mean_direction_elevation_degrees)
        assert angle(mean, vector / np.linalg.norm(vector)) < 1e-6
        for count, said in (
            (1, found.flux_share_of_1_pixel),
            (10, found.flux_share_of_10_pixels),
            (100, found.flux_share_of_100_pixels),
        ):
            assert said == pytest.approx(np.sort(p)[-count:].sum(), rel=1e-12)
        assert found.effective_pixels == pytest.approx(1 / (p**2).sum(), rel=1e-12)


def test_even_light() -> None:
    """A surface has the irradiance E = pi L, and X = 4 pi L cos has the variance (5/3) E^2, wherever it faces."""
    found = analyse(np.full((ROWS, 2 * ROWS, 3), (1.0, 2.0, 3.0)))
    assert found.luminance_minimum == found.luminance_median_by_solid_angle == found.luminance_maximum == 2
    assert found.range_stops == 0
    for side in ("up", "down", "plus_x", "minus_x", "plus_z", "minus_z"):
        irradiance = getattr(found, f"irradiance_{side}_rgb_radiance_sr")
        assert irradiance == pytest.approx(np.pi * np.array([1, 2, 3]), rel=1e-4)
    assert found.mean_direction_length < 1e-12
    assert found.mean_direction_azimuth_degrees is None
    assert found.samples_for_1_percent_error == pytest.approx(1e4 * 5 / 3, rel=1e-3)
    assert found.clipping.verdict == "not clipped"
    assert found.sun is None
    assert "stands out" in found.no_sun_reason


def test_no_light() -> None:
    found = analyse(np.zeros((5, 7, 3)))
    assert found.flux_rgb_radiance_sr == (0, 0, 0)
    assert found.range_stops is None
    assert found.samples_for_1_percent_error is None
    assert found.effective_pixels == 0
    assert (found.clipping.verdict, found.sun, found.no_sun_reason) == ("not clipped", None, "there is no light")


def test_one_pixel_is_all_of_a_map() -> None:
    found = analyse(np.full((1, 1, 3), 5.0))
    assert found.flux_rgb_radiance_sr == pytest.approx([20 * np.pi] * 3)
    assert found.effective_pixels == pytest.approx(1)
    assert found.luminance_median_by_solid_angle == 5
    assert found.clipping.verdict == "not clipped"
    assert found.sun is None


def test_one_pixel_at_the_pole() -> None:
    radiance = np.full((ROWS, 2 * ROWS, 3), 0.01)
    radiance[0, 5] = 1e6
    found = analyse(radiance)
    solid_angle = reference.pixel_solid_angles(ROWS, 2 * ROWS)[0, 5]
    assert found.sun.flux_rgb_radiance_sr == pytest.approx([1e6 * solid_angle] * 3, rel=1e-6)
    assert angle(np.array(found.sun.direction_xyz), reference.directions(ROWS, 2 * ROWS)[0, 5]) < 1e-6
    assert found.flux_share_of_1_pixel == pytest.approx(
        1e6 * solid_angle / (1e6 * solid_angle + 0.04 * np.pi), rel=1e-4
    )


PLACES = [(123.4, 45.6), (0.0, 30.0), (359.9, 5.0), (77.0, 89.9), (10.0, -88.0), (300.0, 2.0)]


@pytest.mark.slow
@pytest.mark.parametrize(("azimuth", "elevation"), PLACES)
@pytest.mark.parametrize("radius", [0.27, 1.0, 3.0])
def test_a_sun_over_a_sky(azimuth: float, elevation: float, radius: float) -> None:
    """Including suns across the seam, at both poles, on the horizon, and smaller than a pixel."""
    found = analyse(under_sun(azimuth, elevation, radius))
    pixel = 180 / ROWS
    assert found.sun is not None, found.no_sun_reason
    assert angle(np.array(found.sun.direction_xyz), unit(azimuth, elevation)) < 0.2 * pixel
    stated = unit(found.sun.azimuth_degrees, found.sun.elevation_degrees)
    assert angle(np.array(found.sun.direction_xyz), stated) < 1e-6
    assert found.sun.flux_rgb_radiance_sr == pytest.approx(FLUX, rel=2e-3)
    assert found.sun.irradiance_rgb_radiance_sr == pytest.approx(FLUX, rel=3e-3)
    total = reference.flux(sky()) + FLUX.mean()
    assert found.sun.flux_share == pytest.approx(FLUX.mean() / total, rel=2e-3)
    # The pixel's width makes it appear larger, the dark limb smaller.
    assert 0.95 * radius < found.sun.angular_radius_degrees < np.hypot(radius, pixel)
    assert not found.sun.is_clipped
    assert found.clipping.verdict == "not clipped"


@pytest.mark.parametrize("elevation", [60.0, 89.5])
@pytest.mark.parametrize(
    ("limit", "factor", "words"), [(65504, 300, "half float"), (1, 0.3, "white"), (37.5, 0.3, "touching")]
)
def test_a_sun_that_is_cut_off(elevation: float, limit: float, factor: float, words: str) -> None:
    whole = sky() * factor + disc(359.9, elevation, 3.0)[..., None] * FLUX * (10 * factor)
    whole *= 10 if limit == 65504 else 1
    radiance = np.minimum(whole, limit)
    found = analyse(radiance)
    at_top = (radiance.astype(np.float32) == limit).sum(axis=(0, 1))
    assert found.clipping.verdict == "clipped"
    assert words in found.clipping.reason
    assert found.clipping.maximum_rgb == (limit,) * 3
    assert found.clipping.pixels_at_maximum_rgb == tuple(at_top)
    any_channel = int((radiance.astype(np.float32) == limit).any(axis=2).sum())
    assert found.clipping.pixels_at_65504 == (any_channel if limit == 65504 else 0)
    assert found.clipping.pixels_at_1 == (any_channel if limit == 1 else 0)
    assert found.sun.is_clipped
    assert angle(np.array(found.sun.direction_xyz), unit(359.9, elevation)) < 0.3
    held = (np.minimum(disc(359.9, elevation, 3.0)[..., None] * FLUX * 1e6, limit)).max(axis=2) > 0
    expected = (radiance * reference.pixel_solid_angles(ROWS, 2 * ROWS)[..., None])[held].sum(axis=0)
    assert found.sun.flux_rgb_radiance_sr == pytest.approx(expected, rel=0.3)
    assert found.sun.flux_rgb_radiance_sr < tuple(FLUX * whole.max())


@pytest.mark.parametrize("elevation", [89.5, 84.0])
def test_narrow_pixels_of_fine_maps_are_taken_together(monkeypatch: pytest.MonkeyPatch, elevation: float) -> None:
    whole = analyse(under_sun(100, elevation, 2)).sun
    monkeypatch.setattr("lightdome.maps.analysis.FINE", 1)
    found = analyse(under_sun(100, elevation, 2)).sun
    assert angle(np.array(found.direction_xyz), unit(100, elevation)) < 0.1
    assert found.flux_rgb_radiance_sr == pytest.approx(whole.flux_rgb_radiance_sr, rel=1e-3)


def test_an_overcast_sky_has_no_sun() -> None:
    up = reference.directions(ROWS, 2 * ROWS)[..., 1:2]
    found = analyse(np.where(up > 0, (1 + 2 * up) / 3, 0.1) * np.ones(3))
    assert found.sun is None
    assert found.clipping.verdict == "not clipped"
    assert found.irradiance_up_rgb_radiance_sr == pytest.approx([7 * np.pi / 9] * 3, rel=1e-4)  # CIE's, of zenith 1


@pytest.mark.parametrize(("lamps", "has_sun"), [(3, False), (2, False), (1, True)])
def test_lamps_that_are_alike_are_no_sun(lamps: int, has_sun: bool) -> None:
    room = 0.02 + 0.01 * reference.directions(ROWS, 2 * ROWS)[..., 1:2]
    light = sum(disc(azimuth, 40, 2) for azimuth in (10, 130, 260)[:lamps])
    found = analyse(room + light[..., None] * np.array([1, 0.8, 0.5]))
    assert (found.sun is not None) == has_sun
    assert has_sun or "another source" in found.no_sun_reason
    assert found.clipping.verdict == "not clipped"


def test_a_large_source_and_a_faint_one_are_no_sun() -> None:
    for radius, flux, words in ((8.0, 10.0, "compact|wide|stands out"), (0.5, 0.1, "% of the light")):
        found = analyse(sky() + disc(60, 45, radius)[..., None] * flux)
        assert found.sun is None
        assert any(word in found.no_sun_reason for word in words.split("|")), found.no_sun_reason


def test_a_plateau_counts_where_blocks_and_rows_meet(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Counts and pairs of neighbours do not depend on the size of bands and blocks, or on the file's order of rows."""
    radiance = np.random.default_rng(3).random((70, 40, 3)).astype(np.float32)
    radiance[20:31, 38:, :2] = 7
    radiance[20:31, :3, :2] = 7
    write_image(tmp_path / "map.pfm", radiance)
    write_image(tmp_path / "map.exr", radiance)
    whole = analyse(radiance)
    assert whole.clipping.verdict == "clipped"
    assert whole.clipping.pixels_at_maximum_rgb[:2] == (55, 55)
    assert whole.clipping.touching_pairs_rgb[:2] == (11 * 4 + 10 * 5,) * 2
    monkeypatch.setattr(images, "BATCH_VALUES", 40 * 3 * 7)
    monkeypatch.setattr("lightdome.maps.analysis.BLOCK_PIXELS", 80)
    for name in ("map.pfm", "map.exr"):
        found = analyse(tmp_path / name)
        assert found.clipping == whole.clipping
        assert found.luminance_median_by_solid_angle == whole.luminance_median_by_solid_angle
        assert found.flux_rgb_radiance_sr == pytest.approx(whole.flux_rgb_radiance_sr, rel=1e-13)


@pytest.mark.parametrize("height", [40, 400])
def test_a_smooth_top_is_not_clipped(height: int) -> None:
    """Even in RGBE's steps of 1/256, where some pixels share the largest value."""
    up = reference.directions(height, 2 * height)[..., 1:2]
    smooth = np.floor(256 * np.exp(4 * up - 4.001)) / 256 * 50 * np.ones(3)
    assert analyse(smooth).clipping.verdict == "not clipped"


def test_half_of_the_range_is_flat() -> None:
    """A map that is clipped at a value that is no format's limit."""
    noise = np.exp(np.random.default_rng(5).normal(size=(ROWS // 2, ROWS, 1)))
    smooth = sum(np.roll(noise, (i, j), (0, 1)) for i in range(-3, 4) for j in range(-3, 4)) / 49
    found = analyse(np.minimum(smooth, np.quantile(smooth, 0.6)) * np.ones(3))
    assert found.clipping.verdict == "clipped"
    assert found.clipping.pixels_at_maximum_rgb[0] == pytest.approx(0.4 * noise.size, abs=2)


def test_bad_values_are_counted_and_left_out(tmp_path: Path) -> None:
    good = sky(32).astype(np.float32)
    bad = good.copy()
    bad[3, 4], bad[5, 6, 1], bad[7, 8], bad[9, 9, 0] = np.nan, np.inf, -1, -np.inf
    good[~((bad >= 0) & (bad < np.inf))] = 0
    found, expected = analyse(bad), analyse(good)
    assert (found.nan_pixels, found.infinite_pixels, found.negative_pixels) == (1, 1, 2)
    assert found.clipping.verdict == "clipped"
    assert "1 pixel is infinite" in found.clipping.reason
    assert found.flux_rgb_radiance_sr == expected.flux_rgb_radiance_sr
    assert found.luminance_median_by_solid_angle == expected.luminance_median_by_solid_angle
    write_image(tmp_path / "bad.pfm", bad)
    assert analyse(tmp_path / "bad.pfm").flux_rgb_radiance_sr == pytest.approx(expected.flux_rgb_radiance_sr)
    for content in (found, analyse(np.full((4, 8, 3), np.nan)), analyse(np.full((4, 8, 3), np.inf))):
        json.dumps(content.to_dict(), allow_nan=False)


def half_exr(path: Path, radiance: np.ndarray) -> Path:
    file = oiio.ImageOutput.create(str(path))
    assert file.open(str(path), oiio.ImageSpec(radiance.shape[1], radiance.shape[0], 3, oiio.HALF))
    with np.errstate(over="ignore"):
        assert file.write_image(radiance.astype(np.float16))
    file.close()
    return path


def test_an_infinite_sun_of_half_floats_is_found(tmp_path: Path) -> None:
    found = analyse(half_exr(tmp_path / "map.exr", under_sun(200, 40, 1) * 100))
    assert found.format == "OpenEXR, half"
    assert found.infinite_pixels > 3
    assert found.clipping.verdict == "clipped"
    assert found.sun.is_clipped
    assert angle(np.array(found.sun.direction_xyz), unit(200, 40)) < 0.2
    assert found.luminance_maximum == 65504


def test_formats_are_named_and_reading_options_are_kept(tmp_path: Path) -> None:
    radiance = sky(16).astype(np.float32)
    write_image(tmp_path / "map.exr", radiance)
    write_image(tmp_path / "map.pfm", radiance[:, :20])
    assert analyse(tmp_path / "map.exr").format == "OpenEXR, float"
    found = analyse(tmp_path / "map.pfm", flip=True)
    assert found.format == "PFM"
    assert "20 x 16, not 2:1" in found.notes[0]
    up, down = (np.array(getattr(found, f"irradiance_{side}_rgb_radiance_sr")) for side in ("up", "down"))
    assert (down > up).all()
    assert analyse(EnvironmentMap(radiance)) == analyse(radiance)
    with pytest.raises(LightdomeError, match="layers"):
        analyse(tmp_path / "map.pfm", layer="diffuse")
    for wrong in (np.zeros((3, 4)), np.zeros((0, 4, 3)), 5):
        with pytest.raises(LightdomeError):
            analyse(wrong)


def test_memory_is_that_of_bands(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """It does not grow with the map's height."""
    monkeypatch.setattr(images, "BATCH_VALUES", 512 * 3 * 16)
    monkeypatch.setattr("lightdome.maps.analysis.BLOCK_PIXELS", 512 * 16)
    peaks = []
    for height in (256, 1024):
        write_image(tmp_path / "map.pfm", np.ones((height, 512, 3), np.float32))
        tracemalloc.start()
        analyse(tmp_path / "map.pfm")
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] - peaks[0] < 0.2 * (1024 - 256) * 512 * 12


@pytest.mark.parametrize(("azimuth", "elevation", "radius"), [(0.0, 30.0, 0.27), (40.0, 89.5, 0.27), (120.0, 1.0, 2.0)])
def test_sun_and_rest_are_the_map(azimuth: float, elevation: float, radius: float) -> None:
    envmap = EnvironmentMap(under_sun(azimuth, elevation, radius))
    split = split_sun(envmap)
    solid_angle = reference.pixel_solid_angles(ROWS, 2 * ROWS)[..., None]
    whole, sun, rest = (
        (part.radiance.astype(np.float64) * solid_angle).sum(axis=(0, 1))
        for part in (envmap, split.sun_map, split.rest)
    )
    np.testing.assert_allclose(sun + rest, whole, rtol=1e-6)
    np.testing.assert_allclose(split.sun.flux_rgb_radiance_sr, sun, rtol=1e-6)
    assert split.rest.radiance.max() <= sky().max() * 1.01
    assert analyse(split.rest).sun is None
    far = angle(reference.directions(ROWS, 2 * ROWS), unit(azimuth, elevation)) > radius + 4 * 180 / ROWS
    assert not split.sun_map.radiance[far].any()


def test_a_sun_that_hides_the_sky_takes_no_light_that_is_not_there() -> None:
    hidden = disc(50, 30, 2)[..., None] > 0
    split = split_sun(EnvironmentMap(np.where(hidden, [900.0, 0.0, 0.0], sky())))
    assert split.sun_map.radiance.min() == 0
    assert split.rest.radiance.min() == 0


def test_a_map_without_a_sun_is_not_split() -> None:
    with pytest.raises(LightdomeError, match="no sun to split off: nothing small"):
        split_sun(EnvironmentMap(sky(64)))
    with pytest.raises(LightdomeError):
        split_sun(sky(64))


def measured(device: Device, envmap: EnvironmentMap, count: int, seeds: int) -> float:
    """The root mean square over seeds of the relative RMSE of ``count`` independent samples."""
    inside = disc_mask(31)
    truth = exact(device, envmap, 31)[inside]
    distribution = build_distribution(device, envmap)
    shaded = (shade_samples(device, distribution.sample(count, seed=seed), 31)[inside] for seed in range(seeds))
    return float(np.sqrt(np.mean([relative_rmse(image, truth) ** 2 for image in shaded])))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["default", "sun", "stiff", "dark in front"])
def test_the_number_of_samples_is_that_which_is_needed(device: Device, name: str) -> None:
    if name == "default":
        envmap = EnvironmentMap.read(Path(__file__).parents[2] / "data" / "default.exr")
    elif name == "stiff":
        envmap = EnvironmentMap(stiff_radiance(60, 100))
    else:
        envmap = EnvironmentMap(under_sun(60 if name == "sun" else 290, 20, 1, 64))
    error = measured(device, envmap, 1000, 100)
    needed = analyse(envmap).samples_for_1_percent_error
    assert error == pytest.approx(0.01 * np.sqrt(needed / 1000), rel=0.15)


def test_grace(device: Device, grace: EnvironmentMap) -> None:
    found = analyse(grace)
    assert found.clipping.verdict == "not clipped"
    assert found.sun is None  # its brightest window is more than 10 degrees wide
    assert found.range_stops == pytest.approx(16.1, abs=0.05)
    error = measured(device, grace, 1000, 100)
    assert error == pytest.approx(0.01 * np.sqrt(found.samples_for_1_percent_error / 1000), rel=0.15)


@pytest.mark.parametrize("shape", [(1, 3), (3, 1), (130, 2), (2, 200), (33, 64)])
@pytest.mark.parametrize("spread", [0.1, 5.0, 20.0])
@pytest.mark.parametrize("scale", [1.0, 1e-42, 1e37])
def test_maps_of_any_shape_and_scale(shape: tuple[int, int], spread: float, scale: float) -> None:
    """Warnings are errors here."""
    light = np.exp(np.random.default_rng(shape[0]).normal(0, spread, (*shape, 3))) * scale
    radiance = np.minimum(light, 3e38).astype(np.float32)
    found = analyse(radiance)
    json.dumps(found.to_dict(), allow_nan=False)
    assert found.luminance_minimum <= found.luminance_median_by_solid_angle <= found.luminance_maximum
    assert found.range_stops is None or found.range_stops >= 0
    if found.sun is not None:
        split = split_sun(EnvironmentMap(radiance))
        solid_angle = reference.pixel_solid_angles(*shape)[..., None]
        flux = (split.sun_map.radiance.astype(np.float64) * solid_angle).sum(axis=(0, 1))
        assert found.sun.flux_rgb_radiance_sr == pytest.approx(flux, rel=1e-5, abs=1e-6 * flux.max())
