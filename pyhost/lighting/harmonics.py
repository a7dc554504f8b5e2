"""Irradiance by spherical harmonics: a smooth, analytic image to compare with, which needs no samples.

A map's radiance is projected onto the real orthonormal harmonics Y_lm; the clamped cosine, which is a zonal
filter, scales each degree l by A_l. Nine coefficients (order 2) come within about 3 % of the exact image of
Grace and of the default map; orders 18 and 24 within 0.1 %. A_l falls as l^(-5/2), and all odd A_l beyond
l = 1 are 0. The image of few coefficients can be negative where the true one is dark; it is left so, since
clamping would hide the error and shift the mean.

The polar axis is +y, azimuth runs from +x to +z as in the map, and no Y_lm has the Condon-Shortley sign:
Y_1,-1, Y_1,0, Y_1,1 = sqrt(3 / 4 pi) (z, y, x). In the code n is the degree l. Source: Ramamoorthi and
Hanrahan, An Efficient Representation for Irradiance Environment Maps (2001), equations 7 to 10; their axes
(x, y, z) are our (x, z, y). Kernels: ``azimuth_sums.cl``, ``harmonics.cl``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from .. import checks
from ..disc import check_resolution, disc_tiles, note_tiles
from ..errors import LightdomeError
from ..float_range import light_exponent, to_float32
from ..maps.envmap import EnvironmentMap
from ..maps.rotation import rotation_matrix
from ..opencl import memory
from ..opencl.device import Device
from ..sampling.device_map import DeviceMap

MAX_ORDER = 64  # float32 holds p_lm / sin^m(theta) up to about 90
TERMS_PER_LAUNCH = 2**33  # pixels x coefficients, a second or so
SEPARATE_CHANNELS = "separate channels", "harmonics of grey maps are computed as those in colour"


@dataclass(frozen=True, eq=False)
class Harmonics:
    """Radiance of a map up to ``order``: ``coefficients`` is ((order + 1)^2, 3) float64, L_lm in row l^2 + l + m.

    The array is read-only. ``Harmonics(coefficients)`` copies it and raises :class:`LightdomeError` for another shape,
    and for values that are not finite. Harmonics are equal if their coefficients are; they cannot be hashed.
    """

    coefficients: np.ndarray

    def __post_init__(self) -> None:
        coefficients = checks.array("coefficients", self.coefficients, ("(order + 1)^2", 3), np.float64, own=True)
        count = len(coefficients)
        if math.isqrt(count) ** 2 != count or count == 0:
            raise LightdomeError(f"harmonics up to order l must have (l + 1)^2 coefficients, got {count}")
        if not (np.abs(coefficients) <= checks.BRIGHTEST).all():
            raise LightdomeError(
                f"coefficients of harmonics must be at most {checks.BRIGHTEST:g}, got larger ones or NaN"
            )
        object.__setattr__(self, "coefficients", coefficients)

    def __eq__(self, other: object) -> bool:
        return checks.same(self, other)

    def __repr__(self) -> str:
        return f"<Harmonics: order {self.order}>"

    @property
    def order(self) -> int:
        """The largest l."""
        return int(np.sqrt(len(self.coefficients))) - 1

    def truncated(self, order: int) -> Harmonics:
        """The harmonics up to ``order``, or all if there are fewer: what :func:`project` would give.

        Raises :class:`LightdomeError` for an order that is not a whole number, 0 or above.
        """
        order = checks.whole("the order of harmonics", order, 0, 2**31 - 1)
        return checks.made(Harmonics, coefficients=self.coefficients[: (order + 1) ** 2])

    def rotated(self, yaw: float, pitch: float = 0.0, roll: float = 0.0) -> Harmonics:
        """The same light, turned as :meth:`lightdome.EnvironmentMap.rotated` turns a map, to float64's accuracy.

        The rotated function of each degree l is projected by a quadrature that is exact for it: Gauss-Legendre in y,
        equal steps in azimuth. Raises :class:`LightdomeError` for an angle that is not finite, and for an order above
        64.
        """
        matrix = rotation_matrix(yaw, pitch, roll)
        order = self.order
        if order > MAX_ORDER:
            raise LightdomeError(f"the order of harmonics must be from 0 to {MAX_ORDER}, got {order}")
        y, weight = np.polynomial.legendre.leggauss(order + 1)
        phi = 2 * np.pi * np.arange(2 * order + 1) / (2 * order + 1)
        radius = np.sqrt(1 - y * y)[:, None]
        x, z = radius * np.cos(phi), radius * np.sin(phi)
        before = np.stack([x, np.broadcast_to(y[:, None], x.shape), z], axis=-1).reshape(-1, 3) @ matrix
        # The function of each degree, before the turn, at these directions.
        value = np.zeros((order + 1, len(before), 3))
        turn = np.outer(np.arange(order + 1), np.arctan2(before[:, 2], before[:, 0]))
        cosine, sine = np.cos(turn), np.sin(turn)
        for n, m, legendre in _legendre(order, before[:, 1], np.hypot(before[:, 0], before[:, 2])):
            of_azimuth = np.outer(cosine[m], self.coefficients[n * n + n + m])
            if m > 0:
                of_azimuth += np.outer(sine[m], self.coefficients[n * n + n - m])
            value[n] += legendre[:, None] * of_azimuth
        in_rows = value.reshape(order + 1, len(y), len(phi), 3)
        weight = weight * 2 * np.pi / len(phi)
        coefficients = np.empty_like(self.coefficients)
        for n, m, legendre in _legendre(order, y, radius[:, 0]):
            of_rows = np.tensordot(legendre * weight, in_rows[n], 1)
            coefficients[n * n + n + m] = np.cos(m * phi) @ of_rows
            if m > 0:
                coefficients[n * n + n - m] = np.sin(m * phi) @ of_rows
        return checks.made(Harmonics, coefficients=coefficients)


def clamped_cosine(order: int) -> np.ndarray:
    """A_l for l = 0 .. ``order``: pi, 2 pi / 3, pi / 4, 0, -pi / 24, ... (Ramamoorthi and Hanrahan, equation 8)."""
    order = checks.whole("the order of harmonics", order, 0, 2**31 - 1)
    A = np.zeros(order + 1)
    A[:2] = (np.pi, 2 * np.pi / 3)[: order + 1]
    central = 1.0  # l! / (2^l (l/2)!^2)
    for n in range(2, order + 1, 2):
        central *= (n - 1) / n
        A[n] = 2 * np.pi * (-1) ** (n // 2 - 1) / ((n + 2) * (n - 1)) * central
    return A


def project(device: Device, envmap: EnvironmentMap | DeviceMap, order: int = 2) -> Harmonics:
    """Project ``envmap`` up to ``order``: L_lm is the sum over pixels of L Y_lm x solid angle.

    A map that is already on the device, such as ``Distribution.map``, is not uploaded again. The device sums along rows
    for each m; the host evaluates the Legendre functions, which are few and sensitive to rounding, in float64.
    Raises :class:`LightdomeError` if ``order`` is not from 0 to 64.
    """
    of_map = DeviceMap.of(device, envmap)
    order = checks.whole("the order of harmonics", order, 0, MAX_ORDER)
    height, width = of_map.height, of_map.width
    device.decisions.use(*SEPARATE_CHANNELS)
    device.decisions.skip(f"harmonics above order {order}", "they were not asked for")
    # m phi_x = pi m (2x + 1) / W, reduced to one turn as an integer.
    turn = np.arange(order + 1)[:, None] * (2 * np.arange(width) + 1) % (2 * width) * (np.pi / width)
    cosine = memory.upload(device, np.cos(turn).astype(np.float32))
    sine = memory.upload(device, np.sin(turn).astype(np.float32))
    sums = memory.empty(device, (height, order + 1, 2, 3), np.float32)
    device.launch(
        "lighting/azimuth_sums",
        (order + 1, height),
        stage="azimuth sums",
        radiance=of_map.radiance,
        cosine=cosine,
        sine=sine,
        width=width,
        scale=of_map.scale,
        sum=sums,
    )
    weighted = memory.download(device, sums) * (of_map.solid_angles / of_map.scale)[:, None, None, None]

    theta = of_map.row_angles
    coefficients = np.zeros(((order + 1) ** 2, 3))
    for n, m, legendre in _legendre(order, np.cos(theta), np.sin(theta)):
        coefficients[n * n + n + m] = legendre @ weighted[:, m, 0]
        if m > 0:
            coefficients[n * n + n - m] = legendre @ weighted[:, m, 1]
    return checks.made(Harmonics, coefficients=coefficients)


def shade_harmonics(device: Device, harmonics: Harmonics, resolution: int = 511, albedo: float = 1.0) -> np.ndarray:
    """The diffuse sphere under ``harmonics``: (R, R, 3) float32, radiance, 0 outside the disc, may be negative.

    A pixel is albedo / pi times the sum of A_l L_lm Y_lm(n). The camera is that of :mod:`lightdome.lighting.shade`.
    Raises :class:`LightdomeError` for a resolution outside 1 to 16384, an order above 64, or an albedo that is
    negative or not finite.
    """
    checks.instance("the device", device, Device)
    checks.instance("the harmonics", harmonics, Harmonics)
    resolution, albedo = check_resolution(resolution), checks.albedo(albedo)
    order = harmonics.order
    if order > MAX_ORDER:
        raise LightdomeError(f"the order of harmonics must be from 0 to {MAX_ORDER}, got {order}")
    a, b = _recurrence(order)
    filtered = harmonics.coefficients * np.repeat(clamped_cosine(order), 2 * np.arange(order + 1) + 1)[:, None]
    terms = []
    for m in range(order + 1):
        for n in range(m, order + 1):
            imaginary = filtered[n * n + n - m] if m > 0 else np.zeros(3)
            terms.append([a[n, m], b[n, m], *filtered[n * n + n + m], *imaginary])
    table = np.array(terms)
    table[:, 2:] *= albedo / np.pi
    pixels = device.vector_width
    tiles = disc_tiles(resolution, pixels, 1)
    device.decisions.use(*SEPARATE_CHANNELS)
    if order > 2:
        device.decisions.skip("odd orders above 1", "the clamped cosine has none")
    note_tiles(device.decisions, tiles, resolution, pixels, 1)
    tile_buffer = memory.upload(device, tiles)
    exponent = light_exponent(np.abs(table[:, 2:]).sum(axis=0).max())
    table[:, 2:] = np.ldexp(table[:, 2:], -exponent)
    term_buffer = memory.upload(device, table.astype(np.float32))
    image = memory.zeros(device, (resolution, resolution, 3), np.float32)
    device.launch(
        "lighting/harmonics",
        (len(tiles),),
        defines={"WIDTH": pixels},
        step=device.items_per_launch(TERMS_PER_LAUNCH, len(table) * pixels),
        progress="shading the sphere",
        tiles=tile_buffer,
        terms=term_buffer,
        order=order,
        resolution=resolution,
        image=image,
    )
    result = memory.download(device, image)
    return to_float32(result, exponent) if exponent else result


def _legendre(order: int, cosine: np.ndarray, sine: np.ndarray) -> Iterator[tuple[int, int, np.ndarray]]:
    """Yield l, m >= 0 and the polar part of Y_lm, p_lm sin^m(theta), (N,), for every l up to ``order``."""
    a, b = _recurrence(order)
    for m in range(order + 1):
        p, p_before = np.zeros(len(cosine)), np.zeros(len(cosine))
        for n in range(m, order + 1):
            now = np.full(len(cosine), a[n, m]) if n == m else a[n, m] * cosine * p - b[n, m] * p_before
            p, p_before = now, p
            yield n, m, now * sine**m


def _recurrence(order: int) -> tuple[np.ndarray, np.ndarray]:
    """a_lm and b_lm of the normalised Legendre functions over sin^m, each (order + 1, order + 1), 0 where m > l.

    p_lm = a_lm cos(theta) p_{l-1,m} - b_lm p_{l-2,m}; a_mm is the constant p_mm itself. Every function of
    m > 0 has the factor sqrt(2) of the real harmonics.
    """
    a, b = np.zeros((order + 1, order + 1)), np.zeros((order + 1, order + 1))
    start = 1 / (4 * np.pi)  # p_mm^2 before that factor
    for m in range(order + 1):
        if m > 0:
            start *= (2 * m + 1) / (2 * m)
        a[m, m] = np.sqrt(start * (2 if m > 0 else 1))
        for n in range(m + 1, order + 1):
            a[n, m] = np.sqrt((4 * n * n - 1) / (n * n - m * m))
            if n > m + 1:
                b[n, m] = np.sqrt((2 * n + 1) / (2 * n - 3) * ((n - 1) ** 2 - m * m) / (n * n - m * m))
    return a, b
