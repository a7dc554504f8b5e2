"""Where a normal's horizon cuts the pixels of a map, and how much light gets past: the tables of ``exact_areas.cl``.

Let n_y be the y of a normal, s = sqrt(1 - n_y^2), and u an azimuth relative to the normal's. On the meridian u the
horizon lies at cot(theta*) = -s cos(u) / n_y. If n_y > 0, theta* falls from u = 0 to u = pi; if n_y < 0, everything is
mirrored upside down. On the meridian u, the row theta_0 .. theta_1 of the map sends

    G(u) = integral of max(0, s cos(u) sin(theta) + n_y cos(theta)) sin(theta) over the row

times the radiance. For u <= h_0, where theta*(h_0) = theta_1, the normal sees all of the row; for u >= h_1, where
theta*(h_1) = theta_0, nothing. A pixel from u_0 to u_1 sends its radiance times I(u_0) - I(u_1), with

    I(u) = integral of G from u to h_1 .

G and its derivatives have closed forms. Between h_0 and h_1, G is smooth: on pieces no longer than a column,
polynomials of degree 6 give I to 1e-10. All normals of an image row share them.
"""

from __future__ import annotations

import numpy as np

# Maps with fewer rows or columns get their pixels split: a column is then short enough for a polynomial, and what the
# horizon cuts is little compared with the rest.
LEAST_SHAPE = (64, 512)
POLES = 4  # a piece is at most 1 / POLES as long as its distance from the nearest pole of theta* in the complex plane


def area_moments(height: int, width: int) -> np.ndarray:
    """The means of sin(theta) cos(phi - phi_centre) and of cos(theta) over the solid angle of a pixel of each row.

    (H, 2) float32: for areas what :func:`lightdome.maps.geometry.sine_cosine` is for centres.
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

    - ``bounds``: (R, count, 4) float32: h_0 and h_1 in columns, the pieces per column from h_0 on, and their number m.
      A row that is not seen has h_1 = 0, and one that is seen whole has h_0 = W / 2; they have no pieces.
    - ``start``: (R, count) uint32, the first of a row's polynomials
    - ``polynomials``: (P, 8) float32, m for the pieces and one for the column before h_0: 7 coefficients in t, from the
      constant up, where t runs from 0 at the larger u to 1; and 1 / the piece's length in columns
    """
    n_y = (resolution - 2.0 * np.arange(resolution)[:, None] - 1) / resolution
    s, b = np.sqrt(1 - n_y**2), np.abs(n_y)
    rows = np.arange(first, first + count)
    rows = np.where(n_y < 0, height - 1 - rows, rows)
    edge, column = _edges(height), 2 * np.pi / width
    low, high = edge[rows], edge[rows + 1]
    h_0, h_1 = _half_arc(s, b, high), _half_arc(s, b, low)
    cut = (h_1 > 0) & (h_0 < np.pi)
    distance = np.maximum(np.hypot(np.clip(np.pi / 2, h_0, h_1) - np.pi / 2, b / s), 1e-30) / POLES
    a_column = np.where(h_1 - h_0 > distance, np.ceil(column / distance), 1)
    pieces = np.where(cut, np.floor((h_1 - h_0) / column * a_column) + 1, 0)
    bounds = np.stack([h_0 / column, h_1 / column, a_column, pieces], axis=2).astype(np.float32)

    # Nodes are the ends of the pieces, in the order of u. Each node but the last stands for the piece that follows it,
    # and the last one, at h_1, for the column before h_0.
    nodes = np.where(cut, pieces + 1, 0).astype(np.int64)
    start = np.cumsum(nodes).reshape(nodes.shape) - nodes
    row = np.repeat(np.arange(nodes.size), nodes.ravel())
    index = np.arange(len(row)) - start.ravel()[row]
    s, b = (np.broadcast_to(a, cut.shape).ravel() for a in (s, b))
    low, high, h_0, h_1, a_column, pieces = (a.ravel() for a in (low, high, h_0, h_1, a_column, pieces))
    u = np.minimum(h_0[row] + index * (column / a_column[row]), h_1[row])
    piece, last = np.flatnonzero(index < pieces[row]), np.flatnonzero(index == pieces[row])
    polynomials = np.zeros((len(row) + 1, 8))  # one more, since no buffer may be empty
    length = u[piece + 1] - u[piece]
    polynomials[piece, 1:7] = _pieces(s[row], b[row], low[row], u, piece, length)
    beyond = np.cumsum(polynomials[::-1].sum(axis=1))[::-1]
    row = row[last]
    polynomials[:-1, 0] = beyond[1:]
    polynomials[last, 0] = beyond[start.ravel()[row]]
    polynomials[:-1, 0] -= np.repeat(beyond[last], nodes.ravel()[row])
    polynomials[last, 1:6] = _column(s[row], b[row], low[row], high[row], h_0[row]) * column ** np.arange(1, 6)
    polynomials[:, :7] /= np.pi
    polynomials[piece, 7] = np.divide(column, length, out=np.zeros_like(length), where=length > 0)
    polynomials[last, 7] = 1
    return bounds, start.astype(np.uint32), polynomials.astype(np.float32)


def _edges(height: int) -> np.ndarray:
    return np.pi * np.arange(height + 1) / height


def _moments(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Integrals of sin^2 and of sin cos from ``low`` to ``high``."""
    difference, total = np.sin(high - low), high + low
    return (high - low - difference * np.cos(total)) / 2, difference * np.sin(total) / 2


def _half_arc(s: np.ndarray, b: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Half the arc of the latitude ``theta`` above the horizon of normals with n_y = b >= 0, radians."""
    return np.arccos(np.clip(-b / s * np.cos(theta) / np.maximum(np.sin(theta), 1e-200), -1, 1))


def _column(s: np.ndarray, b: np.ndarray, low: np.ndarray, high: np.ndarray, h_0: np.ndarray) -> np.ndarray:
    """The Taylor series of I(h_0 - d) - I(h_0) = p sin(d) + q (1 - cos(d)) + r d: coefficients of d to d^5, (N, 5)."""
    sine_squared, sine_cosine = _moments(low, high)
    p, q = s * sine_squared * np.cos(h_0), s * sine_squared * np.sin(h_0)
    return np.stack([p + b * sine_cosine, q / 2, -p / 6, -q / 24, p / 120], axis=1)


def _pieces(
    s: np.ndarray, b: np.ndarray, low: np.ndarray, u: np.ndarray, piece: np.ndarray, length: np.ndarray
) -> np.ndarray:
    """Coefficients of t to t^6, (N, 6), of the integrals from node piece + 1 of u, t = 0, to node piece, t = 1.

    The integrand is the quintic that has the values of G, G' and G'' at both nodes.
    """
    c, slope = s * np.cos(u), s * np.sin(u)
    r = np.maximum(np.hypot(b, c), 1e-200)
    sine, cosine = b / r, -c / r  # of theta*
    t = np.arctan2(b, -c) - low
    sine_t, cosine_t = np.sin(t), np.cos(t)
    # The integral of sin(theta)^2 from `low` to theta*; then G in terms that do not cancel, and its derivatives in -u.
    sine_squared = (t - sine_t * (np.cos(low) * cosine - np.sin(low) * sine)) / 2
    g = r / 2 * (sine * sine_t**2 + cosine * (sine_t * cosine_t - t))
    g_1 = slope * sine_squared
    g_2 = slope**2 * sine**2 * (b / r) / r - c * sine_squared
    value, first, second = g[piece + 1], g_1[piece + 1] * length, g_2[piece + 1] * length**2 / 2
    d_value = g[piece] - value - first - second
    d_first = g_1[piece] * length - first - 2 * second
    d_second = g_2[piece] * length**2 / 2 - second
    quintic = (
        value,
        first,
        second,
        10 * d_value - 4 * d_first + d_second,
        -15 * d_value + 7 * d_first - 2 * d_second,
        6 * d_value - 3 * d_first + d_second,
    )
    return np.stack([term * length / power for power, term in enumerate(quintic, start=1)], axis=1)
