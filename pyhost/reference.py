"""Float64 numpy references, written from the equations; they share no code with the rest of lightdome.

They are slow and plain on purpose: kernels, and other renderers, are checked against them. Conventions: row 0 is at
theta = 0, directions are (sin(theta) cos(phi), cos(theta), sin(theta) sin(phi)), and the camera looks along -z. See
Pharr, Jakob, Humphreys, 4th ed., A.4, A.5 and 12.5.
"""

from __future__ import annotations

from decimal import Decimal, localcontext
from itertools import pairwise

import numpy as np

from .errors import LightdomeError


def angles(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """(theta, phi) of all pixel centres, each (H, W), radians."""
    y, x = np.mgrid[0:height, 0:width]
    return np.pi / height * (y + 0.5), 2 * np.pi / width * (x + 0.5)


def directions(height: int, width: int) -> np.ndarray:
    """Unit vectors of all pixel centres, (H, W, 3)."""
    theta, phi = angles(height, width)
    return np.dstack([np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)])


def pixel_solid_angles(height: int, width: int) -> np.ndarray:
    """Exact solid angles of all pixels, (H, W), steradians: the integral of sin(theta) over each."""
    edge = np.cos(np.pi * np.arange(height + 1) / height)
    return np.repeat((edge[:-1] - edge[1:])[:, None] * 2 * np.pi / width, width, axis=1)


def luminance(radiance: np.ndarray) -> np.ndarray:
    """I = (R + G + B) / 3, (H, W)."""
    return np.asarray(radiance, dtype=np.float64).sum(axis=2) / 3


def probability(radiance: np.ndarray) -> np.ndarray:
    """The discrete p(x, y) proportional to I sin(theta), (H, W); sums to 1."""
    theta, _ = angles(*radiance.shape[:2])
    intensity = luminance(radiance)
    peak = intensity.max()
    weight = intensity / peak * np.sin(theta)
    return weight / weight.sum()


def flux(radiance: np.ndarray) -> float:
    """Phi, the integral of I over the sphere of directions, in radiance x steradian."""
    return float((luminance(radiance) * pixel_solid_angles(*radiance.shape[:2])).sum())


def strip_borders(width: int) -> list[int]:
    """The columns at which a map's vertical strips begin, and its width: up to 8 strips of whole blocks of 16 columns.

    Their number is a power of two, and blocks are divided among them as evenly as they can be.
    """
    blocks = width // 16
    count = next(n for n in (8, 4, 2, 1) if n <= max(blocks, 1))
    return [blocks * i // count * 16 for i in range(count)] + [width]


def invert(radiance: np.ndarray, points: np.ndarray) -> np.ndarray:
    """The pixels (x, y) chosen by points (u_x, u_y) in [0, 1)^2, (N, 2).

    u_x chooses a strip by p(strip), u_y the row by p(y | strip), and what is left of u_x the column by p(x | y, strip).
    """
    p = probability(radiance)
    borders = strip_borders(p.shape[1])
    strips = np.array([p[:, begin:end].sum() for begin, end in pairwise(borders)])
    sums = np.cumsum(strips)
    result = np.empty((len(points), 2), np.int64)
    for i, (u_x, u_y) in enumerate(points):
        s = int(np.searchsorted(sums, u_x * sums[-1], side="right"))
        rest = (u_x * sums[-1] - (sums[s] - strips[s])) / strips[s]
        of_strip = p[:, borders[s] : borders[s + 1]]
        rows = np.cumsum(of_strip.sum(axis=1))
        y = int(np.searchsorted(rows, u_y * rows[-1], side="right"))
        columns = np.cumsum(of_strip[y])
        result[i] = borders[s] + np.searchsorted(columns, rest * columns[-1], side="right"), y
    return result


def normals(resolution: int) -> np.ndarray:
    """Normals of the sphere's pixels, (R, R, 3); NaN outside the disc."""
    n_x = (np.arange(resolution) + 0.5 - resolution / 2) / (resolution / 2)
    n_x, n_y = np.meshgrid(n_x, -n_x)
    inside = 1 - n_x**2 - n_y**2
    n_z = np.sqrt(np.where(inside > 1e-12, inside, np.nan))
    return np.where(np.isnan(n_z)[..., None], np.nan, np.dstack([n_x, n_y, n_z]))


def shade(
    normal: np.ndarray, direction: np.ndarray, radiance: np.ndarray, density: np.ndarray, albedo: float = 1.0
) -> np.ndarray:
    """The estimate (albedo / pi) / N sum of L max(0, n . w) / pdf(w), (..., 3), for normals (..., 3).

    ``direction`` is (N, 3), ``radiance`` (N, 3), and ``density`` (N,) per steradian.
    """
    cosine = np.maximum(normal @ np.asarray(direction, dtype=np.float64).T, 0)
    return albedo / np.pi * cosine @ (radiance / density[:, None]) / len(density)


def exact(radiance: np.ndarray, normal: np.ndarray, albedo: float = 1.0) -> np.ndarray:
    """Radiance of a diffuse surface with normals (M, 3) under the whole map, (M, 3): every pixel once."""
    height, width = radiance.shape[:2]
    weighted = radiance.astype(np.float64) * pixel_solid_angles(height, width)[..., None]
    result = np.zeros((len(normal), 3))
    for w, light in zip(directions(height, width), weighted, strict=True):  # a row at a time
        result += np.maximum(normal @ w.T, 0) @ light
    return albedo / np.pi * result


def exact_areas(radiance: np.ndarray, normal: np.ndarray, albedo: float = 1.0, nodes: int = 16) -> np.ndarray:
    """Radiance of a diffuse surface with normals (M, 3) under a map whose pixels are areas, (M, 3).

    Over theta this is Gauss-Legendre quadrature with ``nodes`` nodes between neighbouring kinks of the integrand, which
    are the edges of rows, the points where the horizon crosses a column's edge, and the horizon's highest and lowest
    points. Over phi it is exact: along a latitude, n . w = a cos(phi - phi_n) + b is positive on a single arc.
    """
    height, width = radiance.shape[:2]
    edge = 2 * np.pi * np.arange(width + 1) / width
    x, weight = np.polynomial.legendre.leggauss(nodes)
    lit = np.flatnonzero(radiance.any(axis=(1, 2)))
    result = np.zeros((len(normal), 3))
    for i, (n_x, n_y, n_z) in enumerate(np.asarray(normal, np.float64)):
        s, phi = np.hypot(n_x, n_z), np.arctan2(n_z, n_x)
        crossings = np.arctan2(n_y, -s * np.cos(np.concatenate([edge - phi, [0, np.pi]]))) % np.pi
        kinks = np.unique(np.concatenate([np.pi * np.arange(height + 1) / height, crossings]))
        middle, half = (kinks[1:] + kinks[:-1]) / 2, (kinks[1:] - kinks[:-1]) / 2
        row = np.minimum((middle / np.pi * height).astype(int), height - 1)
        used = np.isin(row, lit)
        middle, half, row = middle[used, None], half[used, None], row[used]
        # theta = middle + half sin(pi x / 2): smooths square roots at the ends of an interval.
        theta = middle + half * np.sin(np.pi / 2 * x)
        d_theta = half * np.pi / 2 * np.cos(np.pi / 2 * x) * weight
        a, b = (s * np.sin(theta))[..., None], (n_y * np.cos(theta))[..., None]
        arc = np.arccos(np.clip(-b / a, -1, 1))
        turns, azimuth = np.divmod(edge - phi + np.pi, 2 * np.pi)
        end = np.clip(azimuth - np.pi, -arc, arc)
        sums = a * np.sin(end) + b * end + 2 * turns * (a * np.sin(arc) + b * arc)
        of_columns = np.einsum("kq,kqw->kw", np.sin(theta) * d_theta, np.diff(sums, axis=-1))
        result[i] = np.einsum("kw,kwc->c", of_columns, radiance[row].astype(np.float64))
    return albedo / np.pi * result


def relative_rmse(image: np.ndarray, reference: np.ndarray) -> float:
    """sqrt(mean((image - reference)^2)) / sqrt(mean(reference^2)) over the disc of (R, R, 3) images.

    Raises :class:`LightdomeError` for images of any other shape, or of different sizes.
    """
    shape = np.shape(image)
    if shape != np.shape(reference) or shape != (*shape[:1] * 2, 3):
        raise LightdomeError(f"both images must have the same shape (R, R, 3), got {shape} and {np.shape(reference)}")
    inside = ~np.isnan(normals(len(image))[..., 0])
    difference = image[inside].astype(np.float64) - reference[inside]
    return float(np.sqrt((difference**2).mean() / (reference[inside].astype(np.float64) ** 2).mean()))


def sine_and_cosine(angle: float) -> tuple[Decimal, Decimal]:
    """(sin, cos) by Taylor series, to the precision of the decimal context, for angles up to 2 radians."""
    x, term = Decimal(angle), Decimal(1)
    sums = [Decimal(0), Decimal(0)]  # even powers: cosine, odd powers: sine
    for k in range(60):
        sums[k % 2] += term if k % 4 < 2 else -term
        term *= x / (k + 1)
    return sums[1], sums[0]


def fresnel(theta: float, n_i: float, n_t: float) -> tuple[Decimal, Decimal]:
    """(R_p, R_s) by Snell's law and Fresnel's equations, to 50 digits or better."""
    with localcontext() as context:
        context.prec = 60
        a, b = Decimal(n_i), Decimal(n_t)
        sin_i, cos_i = sine_and_cosine(theta)
        sin_t = a * sin_i / b
        if sin_t >= 1:
            return Decimal(1), Decimal(1)
        cos_t = (1 - sin_t**2).sqrt()
        p = (b * cos_i - a * cos_t) / (b * cos_i + a * cos_t)
        s = (a * cos_i - b * cos_t) / (a * cos_i + b * cos_t)
        return p**2, s**2
