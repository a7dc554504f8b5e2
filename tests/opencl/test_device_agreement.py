"""Every OpenCL device gives the same samples to the last bit, and the same images to 1e-5 of their maximum."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyopencl as cl
import pytest
from helpers import stiff_radiance
from lightdome.errors import LightdomeError
from lightdome.lighting.exact import exact
from lightdome.lighting.harmonics import project, shade_harmonics
from lightdome.lighting.median_cut import median_cut, regions
from lightdome.lighting.shade import shade, shade_samples
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.images import ImageRows, write_image
from lightdome.opencl import memory
from lightdome.opencl.device import Device, open_device
from lightdome.opencl.memory import DeviceArray
from lightdome.opencl.programs import Programs
from lightdome.rendering.per_pixel import ESTIMATORS, render
from lightdome.rendering.per_pixel import SEQUENCES as RENDER_SEQUENCES
from lightdome.rendering.product import build_product_cdfs
from lightdome.sampling.cdf import build_row_cdfs
from lightdome.sampling.distribution import Distribution, build_distribution
from lightdome.sampling.samples import SEQUENCES
from lightdome.sampling.streaming import sample_file

R = 33


def made_radiance(spread: int) -> np.ndarray:
    """A map (37, 67, 3) of integers times powers of two, with black pixels, made without any rounding."""
    y, x, c = np.mgrid[0:37, 0:67, 0:3]
    radiance = np.ldexp(((x * 7 + y * 13 + c * 5) % 31).astype(np.float32), (x * 5 + y * 3) % (2 * spread + 1) - spread)
    radiance[(x + 3 * y) % 5 == 0] = 0
    return radiance


MAPS = {"stiff": made_radiance(30), "smooth": made_radiance(0), "tiny": made_radiance(30) * np.float32(2.0**-110)}


def digest(*arrays: np.ndarray) -> str:
    return hashlib.sha256(b"".join(np.ascontiguousarray(a).tobytes() for a in arrays)).hexdigest()[:16]


def samples_of(distribution: Distribution, sequence: str, within: str = "centre") -> str:
    """A digest of samples, for small and large counts."""
    drawn = [distribution.sample(count, 2**40 + 5, sequence, within) for count in (1, 1000, 100_000)]
    return digest(*(a for s in drawn for a in (s.pixel, s.probability, s.direction, s.radiance)))


def images(distribution: Distribution) -> dict[str, np.ndarray]:
    """An image by every method."""
    device, envmap = distribution.device, distribution.envmap
    samples, lights = distribution.sample(1000, 3), median_cut(distribution, 64)
    result = {
        "samples": shade_samples(device, samples, R),
        "brute force": shade(device, samples.direction, samples.flux, R, brute_force=True),
        "exact": exact(device, envmap, R),
        "exact areas": exact(device, envmap, R, pixels="areas"),
        "median cut": shade(device, lights.direction, lights.flux, R),
        "harmonics": shade_harmonics(device, project(device, envmap, 8), R),
    }
    for sequence in RENDER_SEQUENCES:
        for estimator in ESTIMATORS:
            ((_, image),) = render(distribution, [64], R, seed=3, estimator=estimator, sequence=sequence)
            result[f"{estimator} {sequence}"] = image
        for estimator in ("light", "product"):
            ((_, image),) = render(distribution, [64], R, 1.0, 3, estimator, sequence, within="pixel")
            result[f"{estimator} {sequence} within pixels"] = image
    return result


@pytest.fixture(scope="module")
def devices(gpu_shaped: Device) -> list[Device]:
    """Every device that works, and one that runs the kernels for a GPU."""
    result = []
    for p, platform in enumerate(cl.get_platforms()):
        for d in range(len(platform.get_devices())):
            with contextlib.suppress(LightdomeError):
                result.append(open_device(f"{p}:{d}"))
    return [*result, gpu_shaped]


@pytest.mark.parametrize("name", MAPS)
@pytest.mark.parametrize("sequence", SEQUENCES)
def test_the_same_seed_gives_the_same_samples_to_the_last_bit(devices: list[Device], name: str, sequence: str) -> None:
    for device in devices:
        distribution = build_distribution(device, EnvironmentMap(MAPS[name]))
        assert samples_of(distribution, sequence) == RECORDED_SAMPLES[name, sequence], device.description
        assert samples_of(distribution, sequence, "pixel") == RECORDED_WITHIN[name, sequence], device.description


def test_cdfs_and_median_cuts_are_the_same_to_the_last_bit(devices: list[Device]) -> None:
    for device in devices:
        distribution = build_distribution(device, EnvironmentMap(MAPS["stiff"]))
        cdfs = [
            memory.download(device, a)
            for a in (distribution.cdf.rows, distribution.cdf.marginal, distribution.cdf.strips)
        ]
        assert (digest(*cdfs), digest(regions(distribution, 100))) == RECORDED_CDFS, device.description


def tables(distribution: Distribution) -> dict[str, np.ndarray]:
    """Every table used to draw, without the parts that are never read: rows without light, tiles outside the disc."""
    device, cdf, product = distribution.device, distribution.cdf, build_product_cdfs(distribution, 131)
    on_host = {
        name: memory.download(device, array)
        for part in (cdf, cdf.guide, product)
        for name, array in vars(part).items()
        if isinstance(array, DeviceArray)
    }
    on_host["weights above the mean"] = memory.download(device, build_row_cdfs(distribution.map, 1.0).cdf)
    on_host["sums"] = memory.download(device, build_row_cdfs(distribution.map).sums)
    is_lit = on_host["row_total"] > 0
    on_host["rows of the guide"] = memory.download(device, cdf.guide.rows)[is_lit]
    on_host["rows"], on_host["marginal CDF"] = (memory.download(device, a) for a in (cdf.rows, cdf.marginal))
    for name in ("tile_row_cdf", "tile_marginal_cdf", "tile_cones", "tile_moments"):
        on_host[name] = on_host[name][on_host["tile_total"] > 0]
    return on_host


@pytest.mark.parametrize(
    ("height", "width", "is_grey"), [(3, 5000, False), (300, 37, False), (70, 2049, False), (70, 300, True)]
)
def test_tables_of_large_maps_are_the_same_to_the_last_bit(
    devices: list[Device], height: int, width: int, is_grey: bool
) -> None:
    """On a GPU, work-items share a row; with this many pixels or rows, each takes several turns."""
    radiance = stiff_radiance(height, width)
    radiance[0] = 1
    radiance = radiance[..., [0, 0, 0]] if is_grey else radiance
    expected: dict[str, np.ndarray] = {}
    for device in devices:
        distribution = build_distribution(device, EnvironmentMap(radiance))
        drawn_from = tables(distribution)
        moments = drawn_from.pop("tile_moments")  # sums in another order on a GPU, which nothing is drawn by
        first = expected.setdefault("tile_moments", moments)
        largest = np.abs(first).max(axis=(1, 2), keepdims=True)
        assert (np.abs(moments - first) <= 1e-5 * largest).all(), device.description
        for name, table in drawn_from.items():
            np.testing.assert_array_equal(table, expected.setdefault(name, table), f"{name}, {device.description}")
        for count in (1, 100):
            cut = regions(distribution, count)
            np.testing.assert_array_equal(cut, expected.setdefault(f"{count} regions", cut), device.description)
            of_device = median_cut(distribution, count)  # tall_span_sums.cl on a CPU, span_sums.cl on a GPU
            lights = expected.setdefault(f"{count} lights", of_device.flux)
            np.testing.assert_array_equal(of_device.flux, lights, device.description)


def test_images_are_the_same_to_1e_5(devices: list[Device]) -> None:
    first: dict[str, np.ndarray] = {}
    for device in devices:
        result = images(build_distribution(device, EnvironmentMap(MAPS["stiff"])))
        assert result.keys() == RECORDED_MEANS.keys()
        for name, image in result.items():
            assert image.mean(dtype=np.float64) == pytest.approx(RECORDED_MEANS[name], rel=1e-5), name
            expected = first.setdefault(name, image)
            assert np.abs(image - expected).max() <= 1e-5 * expected.max(), f"{name}, {device.description}"


@pytest.mark.slow
def test_nothing_depends_on_what_memory_held_before(devices: list[Device], monkeypatch: pytest.MonkeyPatch) -> None:
    make = cl.Buffer
    for device in devices:
        results = []
        for byte in (0, 0xFF):  # as floats: 0 and NaN

            def filled(
                context: cl.Context,
                flags: int,
                size: int = 0,
                hostbuf: np.ndarray | None = None,
                *,
                queue: cl.CommandQueue = device.queue,
                byte: int = byte,
            ) -> cl.Buffer:
                """A buffer filled as another program might have left it."""
                buffer = make(context, flags, size, hostbuf)
                if flags & cl.mem_flags.READ_WRITE:  # a result's buffer; others hold uploaded arrays
                    cl.enqueue_fill_buffer(queue, buffer, np.uint8(byte), 0, buffer.size)
                return buffer

            monkeypatch.setattr(cl, "Buffer", filled)
            distribution = build_distribution(device, EnvironmentMap(MAPS["stiff"]))
            drawn = [samples_of(distribution, "sobol"), digest(*distribution.sample_pixels(100_000))]
            results.append(drawn + [digest(image) for image in images(distribution).values()])
        assert results[0] == results[1], device.description


class GivenLocalSizes(Programs):
    """Kernels that refuse to choose a local size themselves."""

    def kernel(self, name: str, **defines: int) -> Callable[..., cl.Event]:
        kernel = super().kernel(name, **defines)

        def run(queue: cl.CommandQueue, size: tuple[int, ...], local: object, /, **arguments: object) -> cl.Event:
            assert local is not None, name
            return kernel(queue, size, local, **arguments)

        return run


@pytest.mark.slow
def test_no_kernel_waits_for_a_compiler_at_another_size(devices: list[Device], tmp_path: Path) -> None:
    """Left to choose, PoCL picks a different local size for nearly every global size and compiles each."""
    write_image(tmp_path / "map.pfm", MAPS["stiff"])
    for device in devices:
        if not device.is_gpu:
            checked = replace(device, programs=GivenLocalSizes(device.context, FUSED=int(device.rates.is_fused), CPU=1))
            distribution = build_distribution(checked, EnvironmentMap(MAPS["stiff"]))
            samples_of(distribution, "sobol")
            images(distribution)
            sample_file(checked, ImageRows(tmp_path / "map.pfm"), [5])


# Recorded once. A change that draws or computes other values breaks every user's files.
RECORDED_SAMPLES = {
    ("stiff", "independent"): "fb2c82f8487b6cd5",
    ("stiff", "stratified"): "08dcb4f5d27e047c",
    ("stiff", "sobol"): "ed6381ca22467b93",
    ("stiff", "r2"): "fe1e59fd52c5565e",
    ("stiff", "lattice"): "14df5d3ee3e9b8f4",
    ("smooth", "independent"): "85e1a8476b0f3d30",
    ("smooth", "stratified"): "c08ebaec5b009696",
    ("smooth", "sobol"): "e8de550b9b922e93",
    ("smooth", "r2"): "e45e8973e0461216",
    ("smooth", "lattice"): "0e59d438ee3a9e88",
    ("tiny", "independent"): "d9b197ff364cc6f3",
    ("tiny", "stratified"): "f0d2c63058e7fc53",
    ("tiny", "sobol"): "2ae1f2c00ae3cefa",
    ("tiny", "r2"): "9a36ac4f73e010c5",
    ("tiny", "lattice"): "1b73e1cd42b0c130",
}
RECORDED_WITHIN = {
    ("stiff", "independent"): "7ac06e431b1f6edf",
    ("stiff", "stratified"): "b1eb96cf2550de80",
    ("stiff", "sobol"): "162c960e4c971211",
    ("stiff", "r2"): "34465a68f82ccb8e",
    ("stiff", "lattice"): "bad28e9526165476",
    ("smooth", "independent"): "59e30f630ad48a96",
    ("smooth", "stratified"): "728fc83b5466771e",
    ("smooth", "sobol"): "ead6edaefa64a21a",
    ("smooth", "r2"): "90e99bf4fa7794d6",
    ("smooth", "lattice"): "bac253c674b0fd63",
    ("tiny", "independent"): "86267d6dfec789be",
    ("tiny", "stratified"): "4a8e55593628a2f1",
    ("tiny", "sobol"): "06140a7755823ece",
    ("tiny", "r2"): "14f735c10df81703",
    ("tiny", "lattice"): "7be424bad8d27297",
}
RECORDED_CDFS = ("3224128e9ec72c3e", "0c29caba3feee043")
RECORDED_MEANS = {
    "samples": 3.134795e08,
    "brute force": 3.134795e08,
    "exact": 3.26636e08,
    "exact areas": 3.266668e08,
    "median cut": 3.261766e08,
    "harmonics": 3.266419e08,
    "light independent": 3.27471e08,
    "light sobol": 3.260385e08,
    "light lattice": 3.263774e08,
    "bsdf independent": 3.126272e08,
    "bsdf sobol": 3.207129e08,
    "bsdf lattice": 3.326985e08,
    "mis independent": 3.285754e08,
    "mis sobol": 3.260741e08,
    "mis lattice": 3.265999e08,
    "product independent": 3.266256e08,
    "product sobol": 3.2662e08,
    "product lattice": 3.26673e08,
    "light independent within pixels": 3.274564e08,
    "product independent within pixels": 3.267894e08,
    "light sobol within pixels": 3.260563e08,
    "product sobol within pixels": 3.264014e08,
    "light lattice within pixels": 3.265142e08,
    "product lattice within pixels": 3.265866e08,
}
