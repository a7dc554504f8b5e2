"""No index overflows beyond 2^31 floats; only the size of buffers is limited, and larger ones are refused."""

from __future__ import annotations

import mmap

import numpy as np
import pytest
from lightdome.errors import LightdomeError
from lightdome.maps.envmap import EnvironmentMap
from lightdome.opencl import memory
from lightdome.opencl.device import Device
from lightdome.sampling.distribution import build_distribution

WIDTH, HEIGHT = 32768, 21846  # 3 x WIDTH x HEIGHT is 2^31 + 65536


def black(height: int, width: int) -> np.ndarray:
    """A black map in pages that take no memory until written to, at an address that suits a device."""
    memory = mmap.mmap(-1, 12 * height * width, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    if hasattr(mmap, "MADV_HUGEPAGE"):
        memory.madvise(mmap.MADV_HUGEPAGE)  # seconds instead of a minute to read them
    return np.frombuffer(memory, np.float32).reshape(height, width, 3)


def test_the_last_pixel_of_a_map_beyond_2_31_floats_is_found(device: Device) -> None:
    radiance = black(HEIGHT, WIDTH)
    assert radiance.size > 2**31
    if radiance.nbytes > device.handle.max_mem_alloc_size:
        with pytest.raises(LightdomeError, match=r"holds arrays of up to \d+ MiB and this needs 8192 MiB"):
            memory.upload(device, radiance)
        return
    if not device.shares_host_memory:
        pytest.skip("a device with memory of its own would take 11 GiB of it")
    radiance[0, 0] = radiance[-1, -1] = radiance[-1, 5] = 1, 2, 3
    samples = build_distribution(device, EnvironmentMap(radiance)).sample(300)
    x, y = samples.pixel.T
    assert {(0, 0), (WIDTH - 1, HEIGHT - 1), (5, HEIGHT - 1)} == set(zip(x.tolist(), y.tolist(), strict=True))
    np.testing.assert_allclose(samples.probability, 1 / 3, rtol=1e-6)
    np.testing.assert_array_equal(samples.radiance, np.tile(np.float32((1, 2, 3)), (300, 1)))


def test_what_is_larger_than_the_device_holds_is_refused_before_it_takes_memory(device: Device) -> None:
    with pytest.raises(LightdomeError, match="use fewer samples, a smaller map or image"):
        memory.empty(device, (2**40,), np.float32)
