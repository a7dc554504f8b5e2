"""Check whether an image that another program rendered is the one that the map should give.

Averages of the image over squares of pixels are compared with the irradiance at the normals in their centres, computed
in float64 on the host. Neighbouring squares form a block, and the scatter of the differences within a block gives the
image's noise: a block is wrong if its mean differs by more than ten standard errors. Differences by design (spectra,
interpolation, pixels that are points or areas) are allowed for, with 2 % of the brightest value, and more if the map
has few rows. So the check finds an image lit by white light or by another map, a mirrored image, and half the radiance;
it does not find an error of a few percent, nor one of 10 % at a single sample per pixel.
"""

from __future__ import annotations

import numpy as np

from .. import checks
from ..disc import check_resolution, disc_mask
from ..errors import LightdomeError
from ..maps.envmap import EnvironmentMap
from ..maps.sphere import reflected

STANDARD_ERRORS = 10
SQUARES = 48  # in a row of the image, at most
BLOCK = 6  # squares in a row of a block
FEWEST = 9  # squares from which a standard error is estimated


def deviation(image: np.ndarray, envmap: EnvironmentMap, albedo: float = 1.0) -> str | None:
    """Where and how far ``image``, (R, R, 3), differs from the sphere under ``envmap``, in one line; None if it agrees.

    Always None for an image too small to estimate its noise. Raises :class:`LightdomeError` for an image of another
    shape, and for an albedo that is negative or not finite.
    """
    checks.instance("the map", envmap, EnvironmentMap)
    albedo = checks.albedo(albedo)
    image = np.asarray(image, np.float64)
    if image.ndim != 3 or image.shape != (len(image), len(image), 3):
        raise LightdomeError(f"an image must have the shape (R, R, 3), got {image.shape}")
    resolution = check_resolution(len(image))
    side = -(-resolution // SQUARES)
    count = resolution // side
    inside = _squares(disc_mask(resolution)[..., None], side).min(axis=(1, 3))[..., 0]
    means = _squares(image, side).mean(axis=(1, 3))
    centre = (side * (2 * np.arange(count) + 1) - resolution) / resolution
    nx, ny = np.broadcast_arrays(centre, -centre[:, None])
    normals = np.stack([nx, ny, np.sqrt(np.maximum(1 - nx**2 - ny**2, 0))], axis=-1)
    expected = np.zeros_like(means)
    expected[inside] = albedo * reflected(envmap, normals[inside])

    allowed = (0.02 + 0.5 / envmap.height) * expected.max()
    worst, said = 0.0, None
    for y in range(0, count, BLOCK):
        for x in range(0, count, BLOCK):
            block = np.s_[y : y + BLOCK, x : x + BLOCK]
            here, wanted = (array[block][inside[block]] for array in (means, expected))
            if len(here) < FEWEST:
                continue
            difference = here - wanted
            error = difference.std(axis=0, ddof=1) / np.sqrt(len(difference))
            beyond = np.abs(difference.mean(axis=0)) / (allowed + STANDARD_ERRORS * error + 1e-300)
            channel = int(beyond.argmax())
            if beyond[channel] > max(1.0, worst):
                worst = float(beyond[channel])
                at = side * (min(x + BLOCK // 2, count - 1)), side * (min(y + BLOCK // 2, count - 1))
                said = (
                    f"around pixel {at[0]}, {at[1]} its {['red', 'green', 'blue'][channel]} is"
                    f" {here.mean(axis=0)[channel]:.3g} where the map should give {wanted.mean(axis=0)[channel]:.3g},"
                    f" more than {STANDARD_ERRORS} standard errors away"
                )
    return said


def _squares(array: np.ndarray, side: int) -> np.ndarray:
    """``array`` (R, R, C) split into whole squares of pixels: (count, side, count, side, C)."""
    count = len(array) // side
    return array[: count * side, : count * side].reshape(count, side, count, side, -1)
