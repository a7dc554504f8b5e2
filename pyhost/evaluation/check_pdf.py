"""Is an image of probabilities or densities, or a table of densities by direction, that of a map?"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np

from .. import checks
from ..errors import LightdomeError
from ..maps.envmap import EnvironmentMap
from ..maps.geometry import solid_angles
from .check_laws import laws, right
from .check_samples import CAUSES_OF_SAMPLES, CLOSE, Located, factor_named
from .check_tables import TableCheck, cause_named

PER = ("either", "steradian", "pixel")


def check_pdf(
    envmap: EnvironmentMap,
    pdf: np.ndarray,
    direction: np.ndarray | None = None,
    per: Literal["either", "steradian", "pixel"] = "either",
) -> TableCheck:
    """Compare ``pdf`` with the probabilities of the pixels of ``envmap``, or with the densities per steradian.

    - ``pdf``: (H, W), an image of one or the other; or (N,), densities per steradian at ``direction`` (N, 3)
    - ``per``: what an image must hold, if only one of them is right

    Raises :class:`LightdomeError` for arrays of other shapes, values that are not finite, and for a black map.
    """
    checks.choice("what the values are per", per, PER)
    if direction is not None:
        return Located(envmap, direction, pdf=pdf).result(drawn=False)
    checks.instance("the map", envmap, EnvironmentMap)
    image = checks.array("the pdf", pdf, ("H", "W"), np.float64)
    if not envmap.peak > 0:
        raise LightdomeError("the map is black: nothing can be drawn from it, and there is nothing to check")
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
    """The image as it may have been turned, back in the map's arrangement."""
    if image.shape == p.shape:
        yield "", image
        yield "upside down", image[::-1]
        yield "mirrored left to right", image[:, ::-1]
        yield "turned by 180 degrees", image[::-1, ::-1]
        yield from _rolled(image, p, "")
        yield from _rolled(image[:, ::-1], p, "mirrored left to right and ")
        for step in (1, -1):
            yield f"rows moved by {-step}", np.roll(image, step, axis=0)
    if image.shape == p.shape[::-1]:
        yield "rows and columns exchanged", image.T
        yield "turned by 90 degrees", np.rot90(image)
        yield "turned by 270 degrees", np.rot90(image, 3)


def _rolled(image: np.ndarray, p: np.ndarray, before: str) -> Iterator[tuple[str, np.ndarray]]:
    """The image, its columns moved to where they are most like the map's."""
    turned = np.fft.rfft(p, axis=1) * np.conj(np.fft.rfft(image, axis=1))
    step = int(np.fft.irfft(turned.sum(axis=0), p.shape[1]).argmax())
    if step:
        yield f"{before}columns moved by {p.shape[1] - step} of {p.shape[1]}", np.roll(image, step, axis=1)


def _unlike(values: np.ndarray, q: np.ndarray) -> float:
    """Half the sum of differences, after both are normalised: 0 to 1."""
    total = values.sum()
    return float(np.abs(values / total - q).sum() / 2) if total > 0 else 1.0


def _image(radiance: np.ndarray, image: np.ndarray, per: str) -> TableCheck:
    p = right(radiance)
    p /= p.sum()
    area = solid_angles(*p.shape)[:, None]
    best: tuple[tuple[bool, bool, float], str, str, str, float] | None = None

    def consider(values: np.ndarray, q: np.ndarray, name: str, orientation: str) -> bool:
        """Whether it fits; one whose sum is 1 is better than one whose sum is not."""
        nonlocal best
        for unit, probabilities in ("pixel", values), ("steradian", values * area):
            unlike, total = _unlike(probabilities, q), float(probabilities.sum())
            rank = unlike >= CLOSE, abs(total - 1) >= CLOSE, max(unlike, 1e-5)
            if best is None or rank < best[0]:
                best = rank, name, orientation, unit, total
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
    (_, _, unlike), name, orientation, unit, total = best
    details: dict[str, object] = {"total_variation_distance": unlike, "values_per": unit, "sum": total}
    if unlike >= CLOSE:
        return TableCheck(False, "does not agree; it is the density of no law that is known here", None, "", details)
    causes = []
    if name:
        causes.append((cause_named(name, CAUSES_OF_SAMPLES), ""))
    elif per != "either" and per != unit:
        wrong_unit = "density for probability" if per == "pixel" else "solid angle missing"
        causes.append((cause_named(wrong_unit, CAUSES_OF_SAMPLES), ""))
    if abs(total - 1) > CLOSE:
        if abs(total / p.size - 1) < CLOSE and unit == "pixel":
            causes.append((cause_named("density over the map", CAUSES_OF_SAMPLES), "the mean over the image is 1"))
        else:
            more = f"they sum to {total:.5g}{factor_named(radiance, total)}"
            causes.append((cause_named("not normalised", CAUSES_OF_SAMPLES), more))
    said = [f"{cause.name}: {cause.what}{f' ({more})' if more else ''}" for cause, more in causes]
    said += [orientation] if orientation else []
    if said:
        cause = causes[0][0] if causes else None
        return TableCheck(False, "does not agree; " + "; ".join(said), cause, orientation, details)
    what = "probabilities of pixels" if unit == "pixel" else "densities per steradian"
    return TableCheck(True, f"agrees: {what}, total variation distance {unlike:.2g}", None, "", details)
