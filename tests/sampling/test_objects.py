"""Maps, samples, lights and harmonics in Python: index, iterate, compare, print, show."""

from __future__ import annotations

from pathlib import Path

import lightdome
import numpy as np
import OpenImageIO as oiio
import pytest
from lightdome.errors import LightdomeError
from lightdome.lighting.harmonics import Harmonics
from lightdome.lighting.lights import Lights
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.images import auto_exposure, tone_map
from lightdome.opencl.device import Device
from lightdome.sampling.distribution import build_distribution
from lightdome.sampling.samples import Samples


@pytest.fixture(scope="module")
def samples(device: Device, stiff: EnvironmentMap) -> Samples:
    return build_distribution(device, stiff).sample(50, seed=3, sequence="sobol")


def test_a_part_of_samples_is_samples(samples: Samples, tmp_path: Path) -> None:
    part = samples[10:30:2]
    assert len(part) == 10
    for name in ("direction", "radiance", "probability", "pixel"):
        np.testing.assert_array_equal(getattr(part, name), getattr(samples, name)[10:30:2])
        assert not getattr(part, name).flags.writeable
    # Each stands for more light, since there are fewer.
    np.testing.assert_allclose(part.flux, samples.flux[10:30:2] * (50 / 10), rtol=1e-12)
    part.save(tmp_path / "part.npz")
    assert Samples.load(tmp_path / "part.npz") == part
    np.testing.assert_array_equal(samples[np.array([4, 1])].pixel, samples.pixel[[4, 1]])
    bright = samples.radiance.sum(axis=1) > np.median(samples.radiance)
    assert len(samples[bright]) == bright.sum()
    for none in (samples.probability < 0, slice(0)):
        with pytest.raises(LightdomeError, match="one or more, got none of 50"):
            samples[none]


def test_the_first_of_more_samples_are_those_of_fewer(device: Device, stiff: EnvironmentMap, samples: Samples) -> None:
    assert build_distribution(device, stiff).sample(20, seed=3, sequence="sobol") == samples[:20]


def test_samples_and_lights_are_sequences_of_single_ones(samples: Samples) -> None:
    for n, sample in enumerate(samples):
        assert sample.probability == samples.probability[n] == samples[n].probability
        np.testing.assert_array_equal(sample.pixel, samples.pixel[n])
    assert n == 49
    np.testing.assert_array_equal(samples[-1].direction, samples.direction[49])
    with pytest.raises(IndexError):
        samples[50]
    lights = Lights.of(samples)
    assert [light.flux.tolist() for light in lights] == lights.flux.tolist()
    np.testing.assert_array_equal(lights[2].direction, samples.direction[2])
    part = lights[5:8]
    np.testing.assert_array_equal(part.flux, lights.flux[5:8])  # whatever the other lights are
    assert not part.flux.flags.writeable
    assert len(lights[:0]) == 0


def test_what_has_the_same_content_is_equal(samples: Samples, stiff: EnvironmentMap) -> None:
    lights, harmonics = Lights.of(samples), Harmonics(np.arange(12.0).reshape(4, 3))
    other = np.array(stiff.radiance)
    other[0, 0, 0] += 1
    equal = (
        (EnvironmentMap(stiff.radiance), stiff, EnvironmentMap(other)),
        (samples[:], samples, samples[:-1]),
        (Lights(lights.direction, lights.flux), lights, Lights(lights.direction, 2 * lights.flux)),
        (Harmonics(harmonics.coefficients), harmonics, harmonics.truncated(0)),
    )
    assert stiff.is_grey is False  # cached by the map, not part of its content
    for one, same, another in equal:
        assert one == same
        assert one != another
        assert one != "one"
        assert one is not None
        with pytest.raises(TypeError, match="unhashable"):
            hash(one)


def test_each_says_in_a_line_what_it_is(device: Device, stiff: EnvironmentMap, samples: Samples) -> None:
    distribution = build_distribution(device, stiff)
    lights = Lights(np.array([[0, 1, 0]]), np.array([[1, 2, 0.5]]))
    assert repr(lights) == "<Lights: 1, flux 1 2 0.5 in all>"
    assert repr(samples) == "<Samples: 50 of a 43 x 21 map, sobol, seed 3, centre>"
    assert repr(stiff) == f"<EnvironmentMap: 43 x 21, radiance up to {stiff.peak:.4g}>"
    assert repr(distribution) == (
        f"<Distribution: of a 43 x 21 map, flux {distribution.flux:.4g}, on {device.description}>"
    )
    assert repr(device).startswith(f"<Device: {device.description}, ")
    assert repr(Harmonics(np.zeros((9, 3)))) == "<Harmonics: order 2>"


def pixels_of(png: bytes, folder: Path) -> np.ndarray:
    path = folder / "shown.png"
    path.write_bytes(png)
    file = oiio.ImageInput.open(str(path))
    pixels = file.read_image("uint8")
    file.close()
    return pixels


def test_a_notebook_shows_maps_and_images_tone_mapped(
    device: Device, stiff: EnvironmentMap, samples: Samples, tmp_path: Path
) -> None:
    expected = tone_map(stiff.radiance, auto_exposure(stiff.radiance))
    np.testing.assert_array_equal(pixels_of(stiff._repr_png_(), tmp_path), expected)
    shown = lightdome.show(stiff.radiance, exposure=2, gamma=1)
    np.testing.assert_array_equal(shown.pixels, tone_map(stiff.radiance, 2, 1))
    assert repr(shown) == "<Picture: 43 x 21>"
    np.testing.assert_array_equal(lightdome.show(expected).pixels, expected)
    marked = lightdome.show(stiff.radiance, samples.pixel).pixels
    x, y = samples.pixel.T
    assert (marked[y, x] == (0, 0, 255)).all()
    assert (expected[y, x] != (0, 0, 255)).any()
    outline = (marked != expected).any(axis=2) & (marked != (0, 0, 255)).any(axis=2)
    assert (marked[outline] == 255).all()
    with pytest.raises(LightdomeError, match="inside the 43 x 3 image"):
        lightdome.show(stiff.radiance[:3], samples.pixel)


def test_a_wide_image_is_shown_smaller(tmp_path: Path) -> None:
    image = np.zeros((5, 2050, 3), np.uint8)
    image[3, 30] = 7
    shown = lightdome.show(image, np.array([[2049, 4]])).pixels
    assert shown.shape == (2, 684, 3)
    assert (shown[1, 10] == 7).all()
    assert (shown[1, 683] == (0, 0, 255)).all()


def test_a_notebook_shows_where_samples_and_lights_are(samples: Samples, tmp_path: Path) -> None:
    direction = np.array([[0, 1, 0], [1, 0, 0], [0, 0, 1], [0, 0, -1]])
    flux = np.array([[1, 1, 1], [5, 0, 0], [0, 0.01, 0], [0, 0, 0]])
    pixels = pixels_of(Lights(direction, flux)._repr_png_(), tmp_path)
    assert pixels.shape == (256, 512, 3)
    for place, colour in (
        ((0, 0), (255, 255, 255)),
        ((128, 0), (255, 0, 0)),
        ((128, 510), (255, 0, 0)),
        ((128, 128), (0, 255, 0)),
    ):
        assert tuple(pixels[place]) == colour
    assert tuple(pixels[128, 384]) == (0, 0, 0)
    assert tuple(pixels[60, 300]) == (40, 40, 40)
    assert pixels_of(samples._repr_png_(), tmp_path).shape == (256, 512, 3)
    assert (pixels_of(Lights.of(samples)[:0]._repr_png_(), tmp_path) == 40).all()
