"""Does a curve of reflectances follow Fresnel's equations, and if not, which mistake explains it?"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np

from .. import checks
from ..errors import LightdomeError, quoted
from ..fresnel.equations import critical_angle, fresnel, normal_reflectance, schlick
from .causes import Cause
from .tables import TableCheck, cause_named, column, read_table

CLOSE = 5e-4  # allowed error of a reflectance
SHIFT = 1e-4  # radians; allowed error of an angle, which may have been printed with few digits

CAUSES_OF_CURVES = (
    Cause(
        "p and s swapped",
        "the two polarisations are exchanged",
        "the curve of s has Brewster's angle, and that of p rises all the way",
        "where the two amplitudes are computed: n_t cos(theta_i) - n_i cos(theta_t) belongs to p",
    ),
    Cause(
        "curve ends at the critical angle",
        "the reflectance beyond the critical angle is missing or 0 instead of 1",
        "the curve stops or falls to 0, and the rim of a glass sphere is black from inside",
        "where the square root of 1 - (n_i / n_t)^2 sin(theta)^2 is taken: if it is negative, all light is reflected",
    ),
    Cause(
        "degrees used as radians",
        "angles in degrees are passed to sin and cos",
        "the curve oscillates",
        "where the angle is made: radians = degrees x pi / 180",
    ),
    Cause(
        "radians converted twice",
        "angles are converted to radians twice",
        "the curve is nearly flat",
        "where the angle is made: radians = degrees x pi / 180",
    ),
    Cause(
        "Schlick for Fresnel",
        "the curve is Schlick's approximation instead of Fresnel's equations",
        "a few hundredths off between 60 and 90 degrees, and no Brewster's angle",
        "where the reflectance is computed",
    ),
    Cause(
        "Schlick with the incident angle on the way out",
        "Schlick's approximation is given the angle inside the denser medium, but needs the one outside",
        "the curve rises too late, and does not reach 1 at the critical angle",
        "where the cosine is chosen: on the way out, take that of the transmitted light",
    ),
    Cause(
        "eta inverted",
        "the two refractive indices are exchanged, so that entering and leaving are mixed up",
        "a critical angle where there should be none, or none where there should be one",
        "where n_i and n_t, or eta and 1 / eta, are chosen",
    ),
    Cause(
        "amplitudes averaged",
        "the amplitudes of p and s are averaged and then squared, but their squares must be averaged",
        "too little reflection between 0 and 90 degrees",
        "where p and s are combined for unpolarised light",
    ),
    Cause(
        "amplitudes not squared",
        "the values are amplitudes, but the reflectance is their square",
        "too much reflection: sqrt(R) instead of R",
        "where the reflectance is computed from the amplitude",
    ),
    Cause(
        "one polarisation for both",
        "the reflectance of unpolarised light is that of p or s alone",
        "too much reflection, or none at Brewster's angle",
        "where p and s are combined for unpolarised light: (R_p + R_s) / 2",
    ),
    Cause(
        "p and s added",
        "the reflectances of p and s are added instead of averaged",
        "twice the reflection, up to 2",
        "where p and s are combined for unpolarised light: (R_p + R_s) / 2",
    ),
    Cause(
        "transmittance for reflectance",
        "the values are 1 - R",
        "the curve falls to 0 at 90 degrees",
        "where the result is returned",
    ),
    Cause(
        "percent",
        "the values are in percent",
        "the curve rises to 100",
        "where the result is written",
    ),
    Cause(
        "another refractive index",
        "the curve belongs to another refractive index",
        "the reflectance at normal incidence and Brewster's angle are different",
        "where eta is set",
    ),
)
ANGLES = ("angle", "theta", "incidence", "deg", "radians")
BOTH = ("reflectance", "unpolarised", "unpolarized", "r", "fresnel", "average", "mean", "f", "reflectance_unpolarised")
PARALLEL = ("p", "rp", "r_p", "reflectance_p", "parallel", "r_parallel", "rpar", "reflectance_parallel")
PERPENDICULAR = (
    "s",
    "rs",
    "r_s",
    "reflectance_s",
    "perpendicular",
    "r_perpendicular",
    "rperp",
    "reflectance_perpendicular",
)

# Reflectances of unpolarised, p- and s-polarised light by angle, None where not given.
Curves = tuple[np.ndarray | None, np.ndarray | None, np.ndarray | None]


def read_curves(path: str | Path) -> tuple[np.ndarray, Curves]:
    """The angles, in radians, and the reflectances in a CSV or NPZ file; see :mod:`lightdome.checking.tables`.

    The name of the column says whether angles are in degrees or radians; if it does not, they are in degrees if any
    exceeds pi / 2. Raises :class:`LightdomeError` for a file that cannot be read, or lacks angles or reflectances.
    """
    table = read_table(path)
    name = next((name for start in ANGLES for name in table if name.startswith(start)), None)
    curves = column(table, *BOTH), column(table, *PARALLEL), column(table, *PERPENDICULAR)
    if name is None or all(values is None for values in curves):
        raise LightdomeError(
            f"{path}: expected a column angle_degrees or angle_radians, and reflectance or p and s; got"
            f" {', '.join(map(quoted, list(table)[:12])) or 'no numbers'}"
        )
    angle = column(table, name)
    if angle is None:
        raise LightdomeError(f"{path}: {quoted(name)} must have one angle per row")
    degrees = "deg" in name or ("rad" not in name and np.nanmax(angle, initial=0) > math.pi / 2 + 1e-3)
    return np.radians(angle) if degrees else angle, curves


def check_fresnel(
    theta: np.ndarray,
    reflectance: np.ndarray | None = None,
    p: np.ndarray | None = None,
    s: np.ndarray | None = None,
    *,
    eta: float = 1.4,
    leaving: bool = False,
) -> TableCheck:
    """Compare reflectances (N,) of a dielectric at angles of incidence ``theta`` (N,), radians, with the exact ones.

    - ``reflectance``: of unpolarised light; ``p``, ``s``: of p- and s-polarised light; at least one of the three
    - ``eta``: refractive index of the material, which is surrounded by air
    - ``leaving``: the light leaves the material instead of entering it

    Raises :class:`LightdomeError` for arrays of other shapes, for angles out of range, and if no reflectance is given.
    """
    theta = checks.array("theta", theta, ("N",), np.float64)
    eta, leaving = checks.positive("the refractive index", eta), checks.flag("leaving", leaving)
    given = _map(lambda values: checks.array("a reflectance", values, (len(theta),), np.float64), (reflectance, p, s))
    if all(values is None for values in given) or len(theta) == 0:
        raise LightdomeError("no reflectances to check: give those of unpolarised light, or of p and s")
    if eta == 1:
        raise LightdomeError("eta = 1 is no boundary and reflects nothing")
    a, b = (eta, 1.0) if leaving else (1.0, eta)
    if theta.max() < math.pi / 2 + SHIFT:
        theta = np.minimum(theta, math.pi / 2)
    fresnel(theta, a, b)  # raises for angles out of range
    right = _exact(a, b)
    off, largest, at = _compare(right, theta, given)
    critical = critical_angle(a, b)
    details: dict[str, object] = {
        "angles": len(theta),
        "largest_error": largest,
        "largest_error_at_degrees": math.degrees(theta[at]),
        "critical_angle_degrees": None if critical is None else math.degrees(critical),
    }
    if critical is not None:
        below = theta < critical
        # A table that stops just before the critical angle lacks its last rows.
        stops = below.all() and len(theta) > 9 and critical - theta.max() < np.ptp(theta) / (len(theta) - 1)
        if (stops and off < 1) or (below.any() and not below.all() and _ends(right, theta, given, below)):
            return _told("curve ends at the critical angle", "", details)
    if off < 1:
        return TableCheck.of([], details, f"agrees: the largest error is {largest:.2g}")
    mistakes = [(_compare(curve, theta, given)[0], name, more) for name, curve, more in _mistakes(a, b)]
    fitting = [(name, more) for off, name, more in mistakes if off < 1]
    if fitting:
        return _told(*fitting[0], details)
    index = _other_index(theta, given, leaving)
    if index is not None:
        return _told("another refractive index", f"{index:.4g} for {eta:g}", details)
    where = f"off by {largest:.3g} at {math.degrees(theta[at]):.4g} degrees"
    return TableCheck(agrees=False, verdict=f"does not agree: {where}; no known mistake explains it", details=details)


def _told(name: str, remark: str, details: dict[str, object]) -> TableCheck:
    return TableCheck.of([(cause_named(name, CAUSES_OF_CURVES), remark)], details)


Curve = Callable[[np.ndarray], Curves]


def _map(change: Callable[[np.ndarray], np.ndarray], curves: Sequence[np.ndarray | None]) -> Curves:
    both, p, s = (None if values is None else change(values) for values in curves)
    return both, p, s


def _exact(a: float, b: float) -> Curve:
    """The exact curves for light that goes from index ``a`` to index ``b``."""

    def curve(theta: np.ndarray) -> Curves:
        p, s = fresnel(theta, a, b)
        return (p + s) / 2, p, s

    return curve


def _amplitudes(theta: np.ndarray, a: float, b: float) -> tuple[np.ndarray, np.ndarray]:
    """r_p and r_s for any number, as a program without checks computes them: NaN beyond the critical angle."""
    c, s = np.cos(theta), np.sin(theta)
    with np.errstate(invalid="ignore", divide="ignore"):
        c_t = np.sqrt(1 - (a / b * s) ** 2)
        return (b * c - a * c_t) / (b * c + a * c_t), (a * c - b * c_t) / (a * c + b * c_t)


def _compare(curve: Curve, theta: np.ndarray, given: Curves) -> tuple[float, float, int]:
    """The largest error as a multiple of its tolerance, the largest error, and the index of the latter."""
    around = curve(np.clip(theta - SHIFT, 0, math.pi / 2)), curve(np.clip(theta + SHIFT, 0, math.pi / 2))
    tolerances, errors = np.zeros(len(theta)), np.zeros(len(theta))
    for expected, low, high, values in zip(curve(theta), *around, given, strict=True):
        if values is not None:
            if expected is None or low is None or high is None:
                return math.inf, math.inf, 0
            error = np.abs(values - expected)
            rise = np.abs(np.nan_to_num(high) - np.nan_to_num(low))
            tolerance = error / (CLOSE * max(1.0, float(np.nanmax(expected, initial=0))) + rise)
            both_missing = np.isnan(values) & np.isnan(expected)
            error = np.where(both_missing, 0, np.where(np.isnan(error), np.inf, error))
            tolerance = np.where(both_missing, 0, np.where(np.isnan(tolerance), np.inf, tolerance))
            tolerances, errors = np.maximum(tolerances, tolerance), np.maximum(errors, error)
    return float(tolerances.max()), float(errors.max()), int(errors.argmax())


def _ends(right: Curve, theta: np.ndarray, given: Curves, below: np.ndarray) -> bool:
    """Whether the curve is right up to the critical angle and missing or 0 beyond it."""

    def part(rows: np.ndarray) -> Curves:
        return _map(lambda values: values[rows], given)

    lost = all((np.isnan(v) | (v == 0)).all() for v in part(~below) if v is not None)
    return lost and _compare(right, theta[below], part(below))[0] < 1


def _mistakes(a: float, b: float) -> Iterator[tuple[str, Curve, str]]:
    """The names and curves of known mistakes, the likelier ones first, with a remark on each."""
    exact, r0 = _exact(a, b), normal_reflectance(a, b)

    def of(change: Callable[..., tuple[np.ndarray, np.ndarray, np.ndarray]]) -> Curve:
        return lambda theta: change(*exact(theta)[1:])

    def raw(combine: Callable[[np.ndarray, np.ndarray], Curves], nan: float = math.nan, scale: float = 1.0) -> Curve:
        def curve(theta: np.ndarray) -> Curves:
            return _map(lambda values: np.nan_to_num(values, nan=nan), combine(*_amplitudes(theta * scale, a, b)))

        return curve

    def averaged(mean: Callable[[np.ndarray, np.ndarray], np.ndarray], p: np.ndarray, s: np.ndarray) -> Curves:
        return mean(p, s), p**2, s**2

    def unsquared(sign: Callable[[np.ndarray], np.ndarray], p: np.ndarray, s: np.ndarray) -> Curves:
        return sign(p + s) / 2, sign(p), sign(s)

    def squares(p: np.ndarray, s: np.ndarray) -> Curves:
        return (p**2 + s**2) / 2, p**2, s**2

    def schlick_of(angle: Callable[[np.ndarray], np.ndarray]) -> Curve:
        return lambda theta: (schlick(angle(theta), r0),) * 3

    def outside(theta: np.ndarray) -> np.ndarray:
        return np.arcsin(np.minimum(1, a / b * np.sin(theta)))

    def one_beyond(theta: np.ndarray) -> np.ndarray:
        return np.where(a * np.sin(theta) > b, math.pi / 2, theta)

    yield "p and s swapped", of(lambda p, s: ((p + s) / 2, s, p)), ""
    yield "eta inverted", _exact(b, a), ""
    yield "eta inverted", lambda theta: squares(*_amplitudes(theta, b, a)), "and nothing beyond the critical angle"
    yield "Schlick for Fresnel", schlick_of(outside if a > b else lambda theta: theta), ""
    if a > b:
        name = "Schlick with the incident angle on the way out"
        yield name, schlick_of(lambda theta: theta), ""
        yield name, schlick_of(one_beyond), ""
    yield "one polarisation for both", of(lambda p, s: (s, p, s)), "that of s"
    yield "one polarisation for both", of(lambda p, s: (p, p, s)), "that of p"
    yield "p and s added", of(lambda p, s: (p + s, p, s)), ""
    yield "transmittance for reflectance", of(lambda p, s: (1 - (p + s) / 2, 1 - p, 1 - s)), ""
    yield "percent", of(lambda p, s: (50 * (p + s), 100 * p, 100 * s)), ""
    means = (
        lambda p, s: ((p + s) / 2) ** 2,
        lambda p, s: ((p - s) / 2) ** 2,
        lambda p, s: ((np.abs(p) + np.abs(s)) / 2) ** 2,
    )
    for mean, nan in product(means, (math.nan, 1.0)):
        yield "amplitudes averaged", raw(partial(averaged, mean), nan), ""
    for sign, nan in product((np.abs, np.positive, np.negative), (math.nan, 1.0)):
        yield "amplitudes not squared", raw(partial(unsquared, sign), nan), ""
    yield "degrees used as radians", raw(squares, scale=180 / math.pi), ""
    yield "degrees used as radians", raw(squares, 1.0, 180 / math.pi), ""
    yield "radians converted twice", raw(squares, scale=math.pi / 180), ""


def _other_index(theta: np.ndarray, given: Curves, leaving: bool) -> float | None:
    """The refractive index whose curves these are, or None."""
    low, high = 0.3, 5.0
    best = math.nan
    for _ in range(4):
        grid = np.linspace(low, high, 81)
        off = [_compare(_exact(*(n, 1.0) if leaving else (1.0, n)), theta, given)[0] for n in grid]
        at = int(np.argmin(off))
        best = float(grid[at])
        low, high = float(grid[max(at - 1, 0)]), float(grid[min(at + 1, 80)])
        if off[at] < 1 and high - low < 1e-3:
            return best
    return best if off[at] < 1 else None
