"""Where a normal's horizon cuts the pixels of a map, and how much light passes: the tables of ``exact_areas.cl``.

Let n_y be a normal's height, s = sqrt(1 - n_y^2), and u the azimuth's distance from the normal's. On the meridian u
the horizon lies at cot(theta*) = -s cos(u) / n_y. It falls from theta*(0) to theta*(pi) if n_y > 0; if n_y < 0 the
picture is turned upside down. A row theta_0 .. theta_1 of the map then sends through its meridian u

    G(u) = integral of max(0, s cos(u) sin(theta) + n_y cos(theta)) sin(theta) over the row

times the radiance: for u <= h_0, where theta*(h_0) = theta_1, it sees all of the row, for u >= h_1, where
theta*(h_1) = theta_0, nothing. A pixel from u_0 to u_1 sends its radiance times I(u_0) - I(u_1), with

    I(u) = integral of G from u to h_1 .

G has a closed form, and so have its derivatives. Between h_0 and h_1 it is smooth: pieces no longer than a column
make I polynomials of degree 6, right to 1e-10. All normals of an image row share them.
"""

from __future__ import annotations

import numpy as np

COLUMNS = 512  # at least: a map of fewer has its pixels split, so that a piece or column is short
POLES = 4  # a piece is no longer than this part of its distance from the nearest pole of theta*, as a complex function
TERMS = 8  # of a polynomial in the table; the last is 0


def area_moments(height: int, width: int) -> np.ndarray:
    """Integrals over the pixels of a row of sin(theta) cos(phi - phi_centre) and of cos(theta), over their solid angle.

    What :func:`lightdome.distribution.sine_cosine` is for centres, (H, 2) float32: w, integrated over a pixel.
    """
    edge, column = _edges(height), np.pi / width
    sine_squared, sine_cosine = _moments(edge[:-1], edge[1:])
    solid_angle = 2 * np.sin(np.pi / (2 * height)) * np.sin((edge[:-1] + edge[1:]) / 2)
    moments = np.stack([np.sin(column) / column * sine_squared, sine_cosine], axis=1)
    return (moments / solid_angle[:, None]).astype(np.float32)


def horizon_tables(
    resolution: int, height: int, width: int, first: int, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """I(u) / pi for the R rows of an image and the rows first .. first + count - 1 of a map of at least 512 columns.

    - ``bounds``: (R, count, 4) float32: h_0 and h_1 in columns, the pieces a column and their number m. A row that is
      dark has h_1 = 0, one that is seen whole has h_0 = W / 2; they have no pieces.
    - ``start``: (R, count) uint32, the first of their polynomials
    - ``polynomials``: (P, 8) float32, coefficients from the constant up. The first m are of the pieces from h_1 down to
      h_0, in t from 0 to 1; the one after them is for u < h_0, in columns of h_0 - u up to 1.
    """
    n_y = (resolution - 2.0 * np.arange(resolution)[:, None] - 1) / resolution
    s, b = np.sqrt(1 - n_y**2), np.abs(n_y)
    rows = np.arange(first, first + count)
    rows = np.where(n_y < 0, height - 1 - rows, rows)
    edge, column = _edges(height), 2 * np.pi / width
    low, high = edge[rows], edge[rows + 1]
    h_0, h_1 = _half_arc(s, b, high), _half_arc(s, b, low)
    cut = (h_1 > 0) & (h_0 < np.pi)
    poles = np.hypot(np.clip(np.pi / 2, h_0, h_1) - np.pi / 2, b / s)
    pieces = np.ceil((h_1 - h_0) * np.maximum(1 / column, POLES / np.maximum(poles, 1e-30)))
    pieces = np.where(cut, np.maximum(pieces, 1), 0)
    length = (h_1 - h_0) / np.maximum(pieces, 1)
    with np.errstate(divide="ignore"):
        a_column = np.where(length > 0, column / length, 0)
    bounds = np.stack([h_0 / column, h_1 / column, a_column, pieces], axis=2).astype(np.float32)

    # A node at every end of a piece; that at h_0 has the polynomial for u < h_0.
    nodes = np.where(cut, pieces + 1, 0).astype(np.int64)
    start = np.cumsum(nodes).reshape(nodes.shape) - nodes
    which = np.repeat(np.arange(nodes.size), nodes.ravel())
    index = np.arange(len(which)) - start.ravel()[which]
    s, b = (np.broadcast_to(a, cut.shape).ravel()[which] for a in (s, b))
    low, high, h_0, h_1, length, pieces = (a.ravel()[which] for a in (low, high, h_0, h_1, length, pieces))
    polynomials = np.zeros((len(which) + 1, TERMS))  # one more, since no buffer may be empty
    inner = np.flatnonzero(index < pieces)
    outer = np.flatnonzero(index == pieces)
    _polynomials_of_pieces(polynomials, inner, s, b, low, h_1 - index * length, length)
    whole = np.cumsum(polynomials.sum(axis=1))
    polynomials[1:, 0] = whole[:-1]
    polynomials[:-1, 0] -= polynomials[start.ravel()[which], 0]
    s, b, h_0 = s[outer], b[outer], h_0[outer]
    sine_squared, sine_cosine = _moments(low[outer], high[outer])
    a, e = s * sine_squared * np.cos(h_0), s * sine_squared * np.sin(h_0)
    # Taylor's series of a sin(d) + e (1 - cos(d)) + b d, the integral from h_0 - d to h_0.
    for power, term in enumerate((a + b * sine_cosine, e / 2, -a / 6, -e / 24, a / 120), start=1):
        polynomials[outer, power] = term * column**power
    return bounds, start.astype(np.uint32), (polynomials / np.pi).astype(np.float32)


def _edges(height: int) -> np.ndarray:
    return np.pi * np.arange(height + 1) / height


def _moments(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Integrals of sin^2 and of sin cos from ``low`` to ``high``."""
    difference, total = np.sin(high - low), high + low
    return (high - low - difference * np.cos(total)) / 2, difference * np.sin(total) / 2


def _half_arc(s: np.ndarray, b: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Half the arc of the latitude ``theta`` above the horizon of normals with n_y = b >= 0, radians."""
    return np.arccos(np.clip(-b / s * np.cos(theta) / np.maximum(np.sin(theta), 1e-200), -1, 1))


def _polynomials_of_pieces(
    polynomials: np.ndarray,
    inner: np.ndarray,
    s: np.ndarray,
    b: np.ndarray,
    low: np.ndarray,
    u: np.ndarray,
    length: np.ndarray,
) -> None:
    """Fill the rows ``inner``: integrals of the quintics that share G, G' and G'' with G at the nodes u and the next."""
    c = s * np.cos(u)
    r = np.maximum(np.hypot(b, c), 1e-300)
    sine, cosine = b / r, -c / r  # of theta*
    t = np.arctan2(b, -c) - low
    sine_t, cosine_t = np.sin(t), np.cos(t)
    # The integral of sin(theta)^2 from `low` to theta*, and G, in terms that do not cancel.
    sine_squared = (t - sine_t * (np.cos(low) * cosine - np.sin(low) * sine)) / 2
    g = r / 2 * (sine * sine_t**2 + cosine * (sine_t * cosine_t - t))
    slope = s * np.sin(u)
    # By t, which grows as u falls.
    g_1 = slope * sine_squared * length
    g_2 = (slope**2 * sine**2 * b / r**2 - c * sine_squared) * length**2
    after, length = inner + 1, length[inner]
    p, d, e = g[inner], g_1[inner], g_2[inner] / 2
    dp, dd, de = g[after] - p - d - e, g_1[after] - d - 2 * e, g_2[after] / 2 - e
    quintic = (p, d, e, 10 * dp - 4 * dd + de, -15 * dp + 7 * dd - 2 * de, 6 * dp - 3 * dd + de)
    for power, term in enumerate(quintic, start=1):
        polynomials[inner, power] = term * (length / power)
