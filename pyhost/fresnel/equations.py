"""Fresnel reflectance of a smooth boundary between two transparent media.

Light arrives in the medium of refractive index ``n_i`` at the angle ``theta`` from the normal and
continues, refracted, in the medium of index ``n_t``. With c = cos theta, s = sin theta and

    g = n_t cos theta_t = sqrt(n_t^2 - n_i^2 s^2)            (Snell: n_i s = n_t sin theta_t)

the amplitudes of Born and Wolf, Principles of Optics, 7th ed., section 1.5.2, are

    r_s = (n_i c - g) / (n_i c + g)                          light polarised perpendicular (s)
    r_p = (n_t^2 c - n_i g) / (n_t^2 c + n_i g)              and parallel (p) to the plane of incidence

and the reflectances are their squares. The numerators cancel where the reflectance is small: with indices
1e-7 apart, no digit would be left. With numerators and denominators multiplied by the denominators, they are

    r_s = (n_i^2 - n_t^2) / (n_i c + g)^2
    r_p = (n_t^2 - n_i^2) (n_t c - n_i s) (n_t c + n_i s) / (n_t^2 c + n_i g)^2

and these are computed here. Every difference of squares is written as a product. The cancellation that is
left, at Brewster's angle and the critical angle, is no more than a change in theta's last digit would cause.

:func:`schlick` is the approximation that most renderers use, :func:`schlick_error` says how far off it is,
and :func:`summarise` gives the few numbers that characterise a material in air.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import checks
from ..errors import LightdomeError

Array = NDArray[np.float64]

RIGHT_ANGLE = math.pi / 2


def _angle(theta: ArrayLike) -> Array:
    theta = checks.array("the angle of incidence", theta, None, np.float64)
    # The pi/2 of single precision is 4e-8 above the real one; it still means 90 degrees.
    right = (theta >= 0) & (theta <= RIGHT_ANGLE + 1e-7)
    _all_in(theta, right, "the angle of incidence", "must lie between 0 and pi/2 radians")
    return np.minimum(theta, RIGHT_ANGLE)


def _all_in(values: Array, right: NDArray[np.bool_], what: str, wanted: str) -> None:
    if not right.all():
        raise LightdomeError(f"{what} {wanted}, got {values[~right].flat[0]:g}")


def _together(*values: Array) -> None:
    try:
        np.broadcast_shapes(*(v.shape for v in values))
    except ValueError:
        shapes = " and ".join(str(v.shape) for v in values)
        raise LightdomeError(f"angles and indices must have shapes that broadcast together, got {shapes}") from None


def _indices(n_i: ArrayLike, n_t: ArrayLike) -> tuple[Array, Array]:
    """Both indices, checked, and divided by one power of two: only their ratio matters."""
    i, t = (checks.array("a refractive index", n, None, np.float64) for n in (n_i, n_t))
    for name, n in (("n_i", i), ("n_t", t)):
        _all_in(n, np.isfinite(n) & (n > 0), f"the refractive index {name}", "must be finite and above 0")
    _together(i, t)
    exponent = np.frexp(np.maximum(i, t))[1]
    i, t = np.ldexp(i, -exponent), np.ldexp(t, -exponent)
    if not np.all((i > 0) & (t > 0)):
        raise LightdomeError("the refractive indices n_i and n_t are too far apart: their ratio must be above 5e-324")
    return i, t


def _pair(n_i: float, n_t: float) -> tuple[float, float]:
    """:func:`_indices` of two single numbers."""
    a, b = _indices(n_i, n_t)
    if a.ndim or b.ndim:
        raise LightdomeError(f"a refractive index must be one number here, got an array of shape {a.shape or b.shape}")
    return float(a), float(b)


def _g_squared(c: Array, s: Array, n_i: Array, n_t: Array) -> Array:
    """n_t^2 - n_i^2 s^2; not positive where no light gets through."""
    # The smaller of c and s determines the angle best: sin hardly changes near 90 degrees, and cos hardly near 0.
    return np.where(s < c, (n_t - n_i * s) * (n_t + n_i * s), (n_t - n_i) * (n_t + n_i) + (n_i * c) ** 2)


def fresnel(theta: ArrayLike, n_i: ArrayLike, n_t: ArrayLike) -> tuple[Array, Array]:
    """Reflectances (R_p, R_s) of light polarised parallel and perpendicular to the plane of incidence.

    ``theta``: angle of incidence in radians, 0 to pi/2; ``n_i``, ``n_t``: refractive indices on the side
    of the incident and of the transmitted light, finite and above 0. The three broadcast; both results are
    float64, have the common shape, and lie in [0, 1].

    Accuracy, for ratios of the indices from 1e-150 to 1e150: each value is, to a relative 3e-15, the exact
    one for some angle within two units in the last place of the given angle. That shift matters only next
    to the critical angle, where the reflectance rises with an infinite slope, and for R_p next to Brewster's
    angle, where it is zero. Under total internal reflection the value is exactly 1.

    The float64 nearest to pi/2 stands for 90 degrees, where every boundary reflects all the light: exactly
    1. Equal indices make no boundary: 0 at every angle, 90 degrees included.

    Raises :class:`LightdomeError` for an angle or an index out of range.
    Source: Born and Wolf, section 1.5.2, rearranged as the head of this module says.
    """
    theta, (n_i, n_t) = _angle(theta), _indices(n_i, n_t)
    _together(theta, n_i, n_t)
    c, s = np.cos(theta), np.sin(theta)
    difference = (n_t - n_i) * (n_t + n_i)
    g_squared = _g_squared(c, s, n_i, n_t)
    # n_t c - n_i s. If the indices are far apart, its zero is next to that of g, at a small angle. Both are
    # then computed from the same n_t - n_i s, whose rounding shifts the two zeros by the same angle.
    at_brewster = np.where(s < c, (n_t - n_i * s) - n_t * 2 * np.sin(theta / 2) ** 2, n_t * c - n_i * s)
    everything = (g_squared <= 0) | ((theta == RIGHT_ANGLE) & (n_i != n_t))

    g = np.sqrt(np.maximum(g_squared, 0))
    p_sum = n_t**2 * c + n_i * g
    with np.errstate(all="ignore"):  # the quotients mean nothing under total reflection
        r_s = difference / (n_i * c + g) ** 2
        r_p = difference * (at_brewster / p_sum) * ((n_t * c + n_i * s) / p_sum)
        reflected_p = np.where(everything, 1.0, np.minimum(r_p**2, 1.0))
        reflected_s = np.where(everything, 1.0, np.minimum(r_s**2, 1.0))
    return reflected_p[()], reflected_s[()]  # [()]: scalars in, scalars out


def unpolarised(theta: ArrayLike, n_i: ArrayLike, n_t: ArrayLike) -> Array:
    """Reflectance of unpolarised light, (R_p + R_s) / 2; arguments and errors as in :func:`fresnel`."""
    reflected_p, reflected_s = fresnel(theta, n_i, n_t)
    return (reflected_p + reflected_s) / 2


def refraction_angle(theta: ArrayLike, n_i: ArrayLike, n_t: ArrayLike) -> Array:
    """Angle of the transmitted light in radians by Snell's law; NaN under total internal reflection.

    Arguments and errors as in :func:`fresnel`.
    """
    theta, (n_i, n_t) = _angle(theta), _indices(n_i, n_t)
    _together(theta, n_i, n_t)
    c, s = np.cos(theta), np.sin(theta)
    g_squared = _g_squared(c, s, n_i, n_t)
    g = np.sqrt(np.maximum(g_squared, 0))
    return np.where(g_squared < 0, np.nan, np.arctan2(n_i * s, g))[()]


def normal_reflectance(n_i: float, n_t: float) -> float:
    """Reflectance at normal incidence, ((n_i - n_t) / (n_i + n_t))^2: the same for p and s, and both ways.

    Raises :class:`LightdomeError` for an index that is not finite and above 0.
    """
    a, b = _pair(n_i, n_t)
    return float(((a - b) / (a + b)) ** 2)


def brewster_angle(n_i: float, n_t: float) -> float | None:
    """The angle of incidence in radians at which no p-polarised light is reflected, atan(n_t / n_i).

    None for equal indices, which reflect nothing at any angle. Errors as in :func:`normal_reflectance`.
    """
    a, b = _pair(n_i, n_t)
    return None if a == b else math.atan2(b, a)


def critical_angle(n_i: float, n_t: float) -> float | None:
    """The angle of incidence in radians beyond which all light is reflected, asin(n_t / n_i).

    None for n_t >= n_i, where there is none. Errors as in :func:`normal_reflectance`.
    """
    a, b = _pair(n_i, n_t)
    # As an arc tangent: asin loses half of the digits where the indices are nearly equal.
    return None if b >= a else math.atan2(b, math.sqrt((a - b) * (a + b)))


def schlick(theta: ArrayLike, r0: ArrayLike) -> Array:
    """Schlick's approximation of the unpolarised reflectance, r0 + (1 - r0) (1 - cos theta)^5.

    ``theta``: angle in radians, 0 to pi/2; ``r0``: reflectance at normal incidence, 0 to 1. They broadcast.
    It is meant for light that enters a denser medium. For light that leaves one, it is as good only if theta
    is the angle of the transmitted light, and the reflectance beyond the critical angle is taken as 1.

    Raises :class:`LightdomeError` for an angle or a reflectance out of range.
    Source: Schlick, An Inexpensive BRDF Model for Physically-based Rendering (1994).
    """
    theta, r0 = _angle(theta), checks.array("the reflectance", r0, None, np.float64)
    _all_in(r0, (r0 >= 0) & (r0 <= 1), "the reflectance at normal incidence", "must lie between 0 and 1")
    _together(theta, r0)
    # 90 degrees is where the value is 1; 1 - cos = 2 sin^2(theta/2) does not cancel at small angles.
    rise = np.where(theta == RIGHT_ANGLE, 1.0, (2 * np.sin(theta / 2) ** 2) ** 5)
    return (r0 + (1 - r0) * rise)[()]


@dataclass(frozen=True)
class SchlickError:
    """Where Schlick's approximation is furthest from the exact reflectance of unpolarised light."""

    theta: float  # angle of incidence, radians
    schlick: float
    exact: float

    @property
    def absolute(self) -> float:
        """The largest absolute error."""
        return abs(self.schlick - self.exact)


def schlick_error(n_i: float, n_t: float) -> SchlickError:
    """The largest absolute error of Schlick's approximation over all angles of incidence, 0 to 90 degrees.

    The error is that of :func:`schlick` of the angle of incidence, with r0 from normal incidence, against
    :func:`unpolarised`. It is accurate to about 1e-15; its angle, as at any flat maximum, to about 1e-8.
    Errors as in :func:`normal_reflectance`.
    """
    a, b = _pair(n_i, n_t)
    thin, dense = min(a, b), max(a, b)
    r0 = normal_reflectance(a, b)

    # The search is over the angle on the thinner side: it runs from 0 to 90 degrees whichever way the light
    # goes, and the reflectance is the same function of it both ways. Beyond a critical angle the error only
    # shrinks: the reflectance stays 1 and the approximation rises towards it.
    def incidence(thin_side: Array) -> Array:
        return thin_side if a == thin else refraction_angle(thin_side, thin, dense)

    def error(thin_side: Array) -> Array:
        return np.abs(schlick(incidence(thin_side), r0) - unpolarised(thin_side, thin, dense))

    # Each peak of a grid is searched again on a finer grid between its neighbours, and so on.
    grid = np.linspace(0, RIGHT_ANGLE, 1001)
    values = error(grid)
    padded = np.pad(values, 1, constant_values=-1)
    peaks = np.flatnonzero((values >= padded[:-2]) & (values >= padded[2:]))
    peaks = peaks[np.argsort(values[peaks])][-8:]
    low, high = grid[np.maximum(peaks - 1, 0)], grid[np.minimum(peaks + 1, len(grid) - 1)]
    for _ in range(12):  # each round leaves 2/16 of the interval: 7e10 times narrower in the end
        fine = np.linspace(low, high, 17, axis=-1)
        best = np.argmax(error(fine), axis=-1)
        rows = np.arange(len(fine))
        low, high = fine[rows, np.maximum(best - 1, 0)], fine[rows, np.minimum(best + 1, 16)]

    thin_side = np.asarray(fine.flat[np.argmax(error(fine))])
    theta = float(incidence(thin_side))
    return SchlickError(theta, float(schlick(theta, r0)), float(unpolarised(thin_side, thin, dense)))


@dataclass(frozen=True)
class Summary:
    """What characterises the reflection of a material of index ``eta`` in air (index 1).

    Entering is from air into the material, leaving is from the material into air. Angles are angles of
    incidence in degrees, or None if there is no such angle: there is no critical angle into the denser
    medium, and neither angle at eta = 1. Errors of Schlick's approximation are those of :func:`schlick_error`.
    """

    eta: float
    normal_reflectance_p: float
    normal_reflectance_s: float
    brewster_entering_deg: float | None
    brewster_leaving_deg: float | None
    critical_entering_deg: float | None
    critical_leaving_deg: float | None
    schlick_r0: float
    schlick_entering_max_abs_error: float
    schlick_entering_max_abs_error_at_deg: float
    schlick_leaving_max_abs_error: float
    schlick_leaving_max_abs_error_at_deg: float


def _degrees(angle: float | None) -> float | None:
    return None if angle is None else math.degrees(angle)


def summarise(eta: float) -> Summary:
    """The :class:`Summary` of a material of refractive index ``eta``.

    Raises :class:`LightdomeError` for an index that is not finite and above 0.
    """
    normal_p, normal_s = fresnel(0.0, 1.0, eta)
    entering, leaving = schlick_error(1.0, eta), schlick_error(eta, 1.0)
    return Summary(
        eta=float(eta),
        normal_reflectance_p=float(normal_p),
        normal_reflectance_s=float(normal_s),
        brewster_entering_deg=_degrees(brewster_angle(1.0, eta)),
        brewster_leaving_deg=_degrees(brewster_angle(eta, 1.0)),
        critical_entering_deg=_degrees(critical_angle(1.0, eta)),
        critical_leaving_deg=_degrees(critical_angle(eta, 1.0)),
        schlick_r0=normal_reflectance(1.0, eta),
        schlick_entering_max_abs_error=entering.absolute,
        schlick_entering_max_abs_error_at_deg=math.degrees(entering.theta),
        schlick_leaving_max_abs_error=leaving.absolute,
        schlick_leaving_max_abs_error_at_deg=math.degrees(leaving.theta),
    )
