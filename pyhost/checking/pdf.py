"""Does an image of probabilities or densities, or a table of densities by direction, belong to a map?"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import numpy as np

from .. import checks
from ..errors import LightdomeError
from ..maps.envmap import EnvironmentMap
from ..maps.geometry import solid_angles
from ..maps.images import READABLE, read_image
from .laws import laws, right
from .samples import CAUSES_OF_SAMPLES, CLOSE, Located, factor_named
from .tables import TableCheck, cause_named, column, directions_of, read_table

NAMES = ("pdf", "density", "probability", "p")
PER = ("either", "steradian", "pixel")


def read_pdf(path: str | Path) -> tuple[np.ndarray, np.ndarray | None]:
    """The densities in a PFM, EXR, HDR, NPZ or CSV file, and their directions, which are None for an image.

    Raises :class:`LightdomeError` for a file that cannot be read or lacks densities, and for an image in colour.
    """
    path = checks.path(path)
    if path.suffix.lower() in READABLE:
        image = read_image(path)
        if np.ptp(image, axis=2).any():
            raise LightdomeError(f"{path}: an image of densities must be grey, but this one has colours")
        return image[..., 0], None
    table = read_table(path)
    for name in NAMES:
        if name in table and table[name].ndim == 2:
            return table[name], None
    values = column(table, "pdf", "density")
    if values is None:
        raise LightdomeError(f"{path}: no densities: expected a column or an array named pdf")
    return values, directions_of(table, path)


def check_pdf(
    envmap: EnvironmentMap,
    pdf: np.ndarray,
    direction: np.ndarray | None = None,
    per: Literal["either", "steradian", "pixel"] = "either",
) -> TableCheck:
    """Compare ``pdf`` with the probabilities of the pixels of ``envmap``, or with their densities per steradian.

    - ``pdf``: (H, W), an image of probabilities or densities; or (N,), densities per steradian at ``direction`` (N, 3)
    - ``per``: whether an image must hold probabilities of pixels or densities per steradian; either, by default

    Raises :class:`LightdomeError` for arrays of other shapes, for values that are not finite, and for a black map.
    """
    checks.choice("what the values are per", per, PER)
    if direction is not None:
        return Located(envmap, direction, pdf=pdf).result(drawn=False)
    checks.instance("the map", envmap, EnvironmentMap)
    image = checks.array("the pdf", pdf, ("H", "W"), np.float64)
    if not envmap.peak > 0:
        raise LightdomeError("the map is black: nothing can be drawn from it")
    if not np.isfinite(image).all():
        y, x = np.argwhere(~np.isfinite(image))[0]
        raise LightdomeError(f"the pdf must be finite, got {image[y, x]} at x = {x}, y = {y}")
    size = envmap.height, envmap.width
    if image.shape not in (size, size[::-1]):
        raise LightdomeError(
            f"the pdf must have the map's size, {envmap.width} x {envmap.height} pixels,"
            f" got {image.shape[1]} x {image.shape[0]}"
        )
    return _image(envmap.radiance.astype(np.float64), image, per)


def _arranged(image: np.ndarray, p: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """The image with each way undone in which it may have been turned, and a name for that way."""
    if image.shape == p.shape:
        yield "", image
        yield "upside down", image[::-1]
        yield "mirrored left to right", image[:, ::-1]
        yield "turned by 180 degrees", image[::-1, ::-1]
        if step := _step(image, p):
            yield f"columns moved by {p.shape[1] - step} of {p.shape[1]}", np.roll(image, step, axis=1)
        if step := _step(image[:, ::-1], p):
            name = f"mirrored left to right and columns moved by {step} of {p.shape[1]}"
            yield name, np.roll(image[:, ::-1], step, axis=1)
        for step in (1, -1):
            yield f"rows moved by {-step}", np.roll(image, step, axis=0)
    if image.shape == p.shape[::-1]:
        yield "rows and columns exchanged", image.T
        yield "turned by 90 degrees", np.rot90(image)
        yield "turned by 270 degrees", np.rot90(image, 3)


def _step(image: np.ndarray, p: np.ndarray) -> int:
    """By how many columns the image must move to the right to be most like ``p``."""
    turned = np.fft.rfft(p, axis=1) * np.conj(np.fft.rfft(image, axis=1))
    return int(np.fft.irfft(turned.sum(axis=0), p.shape[1]).argmax())


def _unlike(values: np.ndarray, q: np.ndarray) -> float:
    """The total variation distance between the normalised values and ``q``, 0 to 1."""
    total = values.sum()
    return float(np.abs(values / total - q).sum() / 2) if total > 0 else 1.0


def _image(radiance: np.ndarray, image: np.ndarray, per: str) -> TableCheck:
    p = right(radiance)
    p /= p.sum()
    area = solid_angles(*p.shape)[:, None]
    best: tuple[tuple[bool, bool, float], float, str, str, str, float] | None = None

    def consider(values: np.ndarray, q: np.ndarray, name: str, orientation: str) -> bool:
        """Keep the best of all; say whether this one fits and its sum is 1."""
        nonlocal best
        for unit, probabilities in ("pixel", values), ("steradian", values * area):
            unlike, total = _unlike(probabilities, q), float(probabilities.sum())
            rank = unlike >= CLOSE, abs(total - 1) >= CLOSE, max(unlike, 1e-5)
            if best is None or rank < best[0]:
                best = rank, unlike, name, orientation, unit, total
        assert best is not None
        return not (best[0][0] or best[0][1])

    for orientation, values in _arranged(image, p):
        if consider(values, p, "", orientation):
            break
    else:
        for name, q in laws(radiance):
            if image.shape == p.shape and consider(image, q, name, ""):
                break
    assert best is not None
    _, unlike, name, orientation, unit, total = best
    details: dict[str, object] = {"total_variation_distance": unlike, "values_per": unit, "sum": total}
    if unlike >= CLOSE:
        return TableCheck(agrees=False, verdict="does not agree; no known mistake explains it", details=details)
    causes = []
    if name:
        causes.append((cause_named(name, CAUSES_OF_SAMPLES), ""))
    elif per != "either" and per != unit:
        wrong_unit = "density for probability" if per == "pixel" else "solid angle missing"
        causes.append((cause_named(wrong_unit, CAUSES_OF_SAMPLES), ""))
    if abs(total - 1) > CLOSE:
        if abs(total / p.size - 1) < CLOSE and unit == "pixel":
            causes.append((cause_named("density over the map", CAUSES_OF_SAMPLES), "its mean over the image is 1"))
        else:
            remark = f"they sum to {total:.5g}{factor_named(radiance, total)}"
            causes.append((cause_named("not normalised", CAUSES_OF_SAMPLES), remark))
    what = "probabilities of pixels" if unit == "pixel" else "densities per steradian"
    agreement = f"agrees: {what}, total variation distance {unlike:.2g}"
    return TableCheck.of(causes, details, agreement, orientation, is_turned=bool(orientation))
