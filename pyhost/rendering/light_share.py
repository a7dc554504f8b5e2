"""How many of a pixel's directions are drawn by the light, and how many by the cosine, for the estimator ``mis``.

Let the light sample the share a of all directions, and the cosine b = 1 - a. With f = L c / pi and the density
p = a p_light + b p_bsdf of both together, the balance heuristic makes every direction worth f / p. The variance of N
independent directions is 1 / N times (Veach 1997, 9.2.1)

    integral of f^2 / p  -  a E_light^2  -  b E_bsdf^2

where E_light, the integral of f p_light / p, is the mean over directions sampled by the light, and E_bsdf, the integral
of f p_bsdf / p, that over directions sampled by the cosine; a E_light + b E_bsdf is the image. All of them are means
over samples of the light, whose terms are bounded, and take well under a millisecond. ``mis`` uses the share with the
least sum over some normals. But the variance knows nothing of sequences, which are at their best with equal numbers, so
another share than 1 / 2 must lower it by a margin.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from ..sampling.distribution import Distribution

SHARES = (1 / 2, 1 / 4, 3 / 4, 7 / 8)
UNEQUAL = "unequal numbers of light and cosine samples"
MARGIN = 0.85  # of the variance with the share 1 / 2
SAMPLES, NORMALS = 256, 32


def light_samples(spp: int, share: float) -> int:
    """Of the 2 ``spp`` directions of a pixel, those that the light samples; at least one each."""
    return min(max(round(2 * spp * share), 1), 2 * spp - 1)


def variances(distribution: Distribution, offset: float, flux: float, samples: int = SAMPLES) -> np.ndarray:
    """The variance with each of ``SHARES``, summed over normals and channels, all in the same arbitrary unit.

    The light is drawn by max(0, S - ``offset``), where S is R + G + B of the scaled map; ``flux`` is the integral of
    what is drawn, but of the map itself.
    """
    # Drawn by the map itself, to reach also what the offset leaves out. They are the same on every device.
    drawn = distribution.sample(samples, 0, "lattice")
    scale = distribution.map.scale
    radiance = drawn.radiance * np.float64(scale)
    S = radiance.sum(axis=1)
    c = np.maximum(_normals() @ drawn.direction.T.astype(np.float64), 0)
    q = np.pi / (flux * scale) * np.maximum(S - offset, 0)
    # Integrals are in units of flux / (pi samples).
    unit = np.pi * samples / (3 * distribution.flux * scale)
    of_square, of_channels = unit * (radiance**2).sum(axis=1) / S, radiance / S[:, None]
    image = c @ of_channels

    result = []
    for a in SHARES:
        b = 1 - a
        by_bsdf = c**2 / np.maximum(a * q + b * c, np.finfo(np.float64).tiny)
        mean_bsdf = by_bsdf @ of_channels
        mean_light = (image - b * mean_bsdf) / a
        result.append((by_bsdf @ of_square).sum() - (a * mean_light**2 + b * mean_bsdf**2).sum())
    return np.array(result)


def _normals() -> np.ndarray:
    """Normals of points spread evenly over the sphere's image, (n, 3)."""
    i = np.arange(NORMALS) + 0.5
    r, angle = np.sqrt(i / NORMALS), i * np.pi * (3 - np.sqrt(5))
    return np.stack([r * np.cos(angle), r * np.sin(angle), np.sqrt(1 - r**2)], axis=1)


def choose_share(distribution: Distribution, offset: float = 0.0, flux: float | None = None) -> float:
    """The share for a map, see above and :func:`variances`; the device's decisions tell it and why."""
    decisions = distribution.device.decisions
    of_half, *_ = of_shares = variances(distribution, offset, flux or 3 * distribution.flux)
    best = int(np.argmin(of_shares))
    if of_shares[best] >= MARGIN * of_half:
        decisions.skip(UNEQUAL, f"no other share would lower the variance by {1 - MARGIN:.0%}")
        return SHARES[0]
    left = max(of_shares[best] / of_half, 0)
    drawn = f"{Fraction(SHARES[best])} of the directions are drawn by the light"
    decisions.use(UNEQUAL, f"{drawn}, which leaves {left:.0%} of the variance with equal numbers")
    return SHARES[best]
