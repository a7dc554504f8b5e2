"""The diffuse sphere by Monte Carlo with fresh samples for every pixel: noise instead of bias.

The image of N samples a pixel is unbiased and its error falls as 1 / sqrt(N). Kernel: ``render.cl``.
Source: Pharr, Jakob, Humphreys, Physically Based Rendering, 4th ed., 13.2.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from . import buffers
from .disc import check_resolution, disc_tiles
from .distribution import Distribution, philox_key
from .errors import LightdomeError
from .progress import Progress

SAMPLES_A_LAUNCH = 2**22  # pixels x spp between two updates of the progress line


def render(
    distribution: Distribution,
    spp: Sequence[int],
    resolution: int = 511,
    albedo: float = 1.0,
    seed: int = 0,
) -> Iterator[tuple[int, np.ndarray]]:
    """Yield (spp, image) for each of ``spp`` in increasing order; images are (R, R, 3) float32 radiance.

    An image of more samples continues the one of fewer, so all cost as much as the largest. A black map
    gives black. Raises :class:`LightdomeError` for a resolution or a number of samples out of range.
    """
    check_resolution(resolution)
    if not spp or min(spp) < 1 or max(spp) >= 2**31:
        raise LightdomeError(f"samples a pixel are from 1 to 2147483647, not {list(spp)}")
    device, envmap = distribution.device, distribution.envmap
    total = buffers.zeros(device, (resolution, resolution, 3), np.float32)
    disc = buffers.upload(device, disc_tiles(resolution, 1, 1))
    kernel = device.kernel("render", SEQUENCE_INDEPENDENT=1)
    step = max(1, SAMPLES_A_LAUNCH // disc.shape[0])
    done = 0
    with Progress("rendering") as progress:
        for target in sorted(set(spp)):
            while done < target and distribution.total > 0:
                end = min(done + step, target)
                event = kernel(
                    device.queue,
                    (disc.shape[0],),
                    None,
                    distribution.row_cdf.buffer,
                    distribution.marginal_cdf.buffer,
                    distribution.radiance.buffer,
                    distribution.theta.buffer,
                    distribution.phi.buffer,
                    np.uint32(envmap.width),
                    np.uint32(envmap.height),
                    np.float32(distribution.scale),
                    np.float32(3 * distribution.flux * albedo / np.pi),
                    philox_key(seed),
                    np.uint32(done),
                    np.uint32(end),
                    disc.buffer,
                    np.int32(resolution),
                    total.buffer,
                )
                device.profile.record("render", event).wait()
                done = end
                progress.update(done / max(spp))
            yield target, buffers.download(device, total) / np.float32(target)
