"""Figures of Fresnel reflectance and of Schlick's approximation, with their characteristic points named.

:func:`fresnel_figure` shows both polarisations and unpolarised light for one direction through a
boundary, :func:`schlick_figure` the approximation beside the exact curve and their difference; :func:`save`
writes a figure as PNG and SVG. Lines differ in colour (Okabe and Ito's palette, safe for colour-blind
readers), in style and in width, so that they also differ in grey.

Labels are set where they hide nothing: :class:`_Labels` tries positions and keeps the best.
No pyplot: figures are plain objects, no window opens, and no state is left behind.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .. import plotting  # first: it imports matplotlib

# isort: split
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox
from numpy.typing import ArrayLike

from ..errors import exactly
from ..plotting import BLACK, BLUE, VERMILLION
from .equations import (
    RIGHT_ANGLE,
    brewster_angle,
    critical_angle,
    fresnel,
    normal_reflectance,
    refraction_angle,
    schlick,
    schlick_error,
    unpolarised,
)

DPI = 150
GREY = "#E6E6E6"

_STYLE = {
    "figure.dpi": DPI,
    "font.size": 11.0,
    "axes.titlesize": 13.0,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": "#DDDDDD",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "mathtext.default": "regular",
}


class _Labels:
    """Sets labels in one axes where they cover neither curves nor each other.

    ``curves``: list of (x, y) in data coordinates. Geometry is in pixels from the lower left corner of the
    axes; ``ink`` and ``text`` are maps of the pixels that lines and labels already take.
    """

    GAP = 11  # clear space round a label
    NEAR = 5  # an arrow closer than this to a line looks like crossing it

    def __init__(self, ax: Axes, curves: list[tuple[np.ndarray, np.ndarray]]) -> None:
        self.ax = ax
        self.ink = np.zeros(np.ceil(ax.bbox.size).astype(int) + 1, dtype=bool)
        self.text = np.zeros_like(self.ink)
        for x, y in curves:
            self._draw(self._pixels(np.c_[x, y]))

    def _pixels(self, data: ArrayLike) -> np.ndarray:
        return self.ax.transData.transform(data) - self.ax.bbox.min

    def _draw(self, path: np.ndarray) -> None:
        """Mark the polyline ``path``, (n, 2)."""
        along = np.r_[0, np.cumsum(np.hypot(*np.diff(path, axis=0).T))]
        at = np.linspace(0, along[-1], 2 + int(along[-1]))
        pixels = np.c_[np.interp(at, along, path[:, 0]), np.interp(at, along, path[:, 1])].astype(int)
        pixels = pixels[((pixels >= 0) & (pixels < self.ink.shape)).all(axis=1)]
        self.ink[tuple(pixels.T)] = True

    @staticmethod
    def _sums(taken: np.ndarray) -> np.ndarray:
        """The summed-area table of ``taken``: how many of its pixels lie below and left of each corner."""
        return np.pad(taken.cumsum(axis=0, dtype=np.int32).cumsum(axis=1, dtype=np.int32), ((1, 0), (1, 0)))

    @staticmethod
    def _count(sums: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """How many taken pixels lie in each of the boxes from ``low`` to ``high``, (..., 2) each."""
        limit = np.array(sums.shape) - 1
        x0, y0 = np.moveaxis(np.clip(low, 0, limit).astype(int), -1, 0)
        x1, y1 = np.moveaxis(np.clip(high + 1, 0, limit).astype(int), -1, 0)
        return sums[x1, y1] - sums[x0, y1] - sums[x1, y0] + sums[x0, y0]

    def _cost(self, low: np.ndarray, high: np.ndarray, target: np.ndarray | None) -> np.ndarray:
        """How bad labels in the boxes ``low`` to ``high``, (n, 2), with arrows to ``target`` would be."""
        ink, text = self._sums(self.ink), self._sums(self.text)
        cost = self._count(ink, low - self.GAP, high + self.GAP) * 1e3
        cost += self._count(text, low - self.GAP, high + self.GAP) * 1e5
        if target is None:
            centre = (low + high) / 2
            return cost + np.hypot(*(centre - centre.mean(axis=0)).T)
        start = np.clip(target, low, high)
        distance = np.hypot(*(target - start).T)
        arrow = start[:, None] + np.linspace(0, 1, 49)[:, None] * (target - start)[:, None]
        cost += self._count(text, arrow, arrow).sum(axis=1) * 1e4
        # Crossing a line is worse than being long; the last bit, at the target, may touch its curve.
        near = self._count(ink, arrow - self.NEAR, arrow + self.NEAR) > 0
        near &= np.hypot(*np.moveaxis(arrow - target, -1, 0)) > 2 * self.NEAR
        cost += 10 * distance * near.mean(axis=1)
        return cost + distance + 20 * np.maximum(0, 45 - distance)

    def add(self, text: str, target: tuple[float, float] | None = None, within: Bbox | None = None) -> None:
        """Write ``text``, with an arrow to the data point ``target``; ``within``: data area to stay in."""
        ax = self.ax
        label = ax.text(0, 0, text, fontsize=10.5, ha="center", va="center", linespacing=1.35, zorder=6)
        half = label.get_window_extent().size / 2
        area = np.array([[0, 0], ax.bbox.size]) if within is None else self._pixels(within.get_points())
        low, high = area[0] + half + self.GAP, area[1] - half - self.GAP
        grid = np.meshgrid(np.linspace(low[0], high[0], 49), np.linspace(low[1], high[1], 33))
        centres = np.stack(grid, axis=-1).reshape(-1, 2)
        goal = None if target is None else self._pixels(target)
        centre = centres[np.argmin(self._cost(centres - half, centres + half, goal))]

        def data(pixels: np.ndarray) -> np.ndarray:
            return ax.transData.inverted().transform(pixels + ax.bbox.min)

        label.set_position(data(centre))
        corners = np.clip([centre - half - 2, centre + half + 3], 0, self.text.shape).astype(int)
        self.text[corners[0, 0] : corners[1, 0], corners[0, 1] : corners[1, 1]] = True
        if target is None or goal is None:
            return
        start = np.clip(goal, centre - half - 3, centre + half + 3)
        look = {"arrowstyle": "-|>", "color": BLACK, "linewidth": 0.9, "shrinkA": 0, "shrinkB": 3}
        ax.annotate("", xy=target, xytext=data(start), arrowprops=look, zorder=5)
        ax.plot(*target, "o", color=BLACK, markersize=5, clip_on=False, zorder=7)
        self._draw(np.array([start, goal]))


def _angles(n_i: float, n_t: float) -> np.ndarray:
    """Angles of incidence in radians that draw every bend of the curves for this boundary."""
    even = np.linspace(0, RIGHT_ANGLE, 1001)
    marks = [a for a in (brewster_angle(n_i, n_t), critical_angle(n_i, n_t)) if a is not None]
    if n_i > n_t:  # infinitely steep below the critical angle: close ranks there
        marks += list(refraction_angle(even, n_t, n_i))
    return np.union1d(even, marks)


def _g(value: float, digits: int) -> str:
    """A number with that many digits, and with a power of ten as mathematics writes it."""
    mantissa, _, exponent = f"{value:#.{digits}g}".partition("e")
    return rf"${mantissa} \times 10^{{{int(exponent)}}}$" if exponent else mantissa


def _degrees(angle: float, digits: int = 6) -> str:
    return f"{_g(np.degrees(angle), digits)}°"


def _title(what: str, n_i: float, n_t: float, from_name: str, to_name: str) -> str:
    return f"{what}: {from_name} ($n_i$ = {exactly(n_i)}) to {to_name} ($n_t$ = {exactly(n_t)})"


def _figure(height: float, rows: list[float]) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(9.0, height))
    FigureCanvasAgg(figure)
    grid = {"height_ratios": rows, "left": 0.1, "right": 0.97, "hspace": 0.12}
    grid |= {"bottom": 0.62 / height, "top": 1 - 0.85 / height}
    axes = figure.subplots(len(rows), 1, sharex=True, gridspec_kw=grid, squeeze=False)[:, 0]
    for ax in axes:
        ax.set_xlim(0, 90)
        ax.set_xticks(np.arange(0, 91, 10))
    axes[-1].set_xlabel("angle of incidence (degrees)")
    axes[0].set_ylabel("reflectance (fraction of incident power)")
    axes[0].set_ylim(-0.04, 1.04)
    axes[0].set_yticks(np.linspace(0, 1, 6))
    return figure, list(axes)


def _heading(ax: Axes, title: str) -> None:
    """Title and legend above the axes, where no curve can run through them."""
    ax.set_title(title, pad=34)
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 0.995), ncols=3, handlelength=3.4, columnspacing=2.2)


def _shade_total_reflection(ax: Axes, critical: float | None, word: bool, labels: _Labels) -> None:
    if critical is None:
        return
    start = np.degrees(critical)
    ax.axvspan(start, 90, color=GREY, zorder=0, linewidth=0)
    if word and start < 70:
        labels.add("total internal reflection", within=Bbox([[start, 0.05], [90, 0.95]]))


def fresnel_figure(n_i: float, n_t: float, from_name: str = "side i", to_name: str = "side t") -> Figure:
    """Reflectance of p-polarised, s-polarised and unpolarised light, 0 to 90 degrees of incidence.

    ``n_i``, ``n_t``: refractive indices on the sides of the incident and the transmitted light, finite and
    above 0, else :class:`LightdomeError`; ``from_name``, ``to_name``: what the title calls the two sides.
    Normal incidence, Brewster's angle and the critical angle are marked where they exist.
    """
    with plotting.plain(**_STYLE):
        theta = _angles(n_i, n_t)
        x = np.degrees(theta)
        reflected_p, reflected_s = fresnel(theta, n_i, n_t)
        figure, (ax,) = _figure(5.6, [1])
        ax.plot(x, reflected_s, "--", color=BLUE, linewidth=2, label="$R_s$, perpendicular", zorder=3)
        ax.plot(x, unpolarised(theta, n_i, n_t), "-", color=BLACK, linewidth=2.4, label="unpolarised", zorder=3)
        dots = (0, (1.2, 1.2))
        ax.plot(x, reflected_p, ls=dots, color=VERMILLION, linewidth=2.6, label="$R_p$, parallel", zorder=3)
        _heading(ax, _title("Fresnel reflectance", n_i, n_t, from_name, to_name))

        labels = _Labels(ax, [(x, reflected_p), (x, reflected_s), (x, (reflected_p + reflected_s) / 2)])
        critical, brewster = critical_angle(n_i, n_t), brewster_angle(n_i, n_t)
        r0 = normal_reflectance(n_i, n_t)
        labels.add(f"normal incidence\n$R_p$ = $R_s$ = {_g(r0, 5)}", (0, r0))
        if brewster is not None:
            at = np.degrees(brewster)
            # Beside its minimum rather than across the steep rise, where there is room for it.
            near = Bbox([[0, 0], [np.degrees(critical), 1]]) if critical is not None and critical > 0.6 else None
            labels.add(f"Brewster's angle {_degrees(brewster)}\n$R_p$ = 0", (at, 0), near)
        if critical is not None:
            labels.add(f"critical angle {_degrees(critical)}\nall reflected beyond", (np.degrees(critical), 1))
        _shade_total_reflection(ax, critical, True, labels)
        return figure


def schlick_figure(n_i: float, n_t: float, from_name: str = "side i", to_name: str = "side t") -> Figure:
    """Schlick's approximation beside the exact reflectance of unpolarised light, and their difference.

    Arguments and errors as in :func:`fresnel_figure`. R0 and the largest absolute error are marked. For
    light that leaves the denser side the approximation is drawn twice: with the angle of incidence, as
    compared, and with the angle of the transmitted light, which mends it.
    """
    with plotting.plain(**_STYLE):
        theta = _angles(n_i, n_t)
        worst = schlick_error(n_i, n_t)
        theta = np.union1d(theta, worst.theta)
        x = np.degrees(theta)
        r0 = normal_reflectance(n_i, n_t)
        exact, approximate = unpolarised(theta, n_i, n_t), schlick(theta, r0)
        critical = critical_angle(n_i, n_t)

        figure, (above, below) = _figure(7.4, [1.9, 1])
        above.plot(x, exact, "-", color=BLACK, linewidth=2.4, label="exact, unpolarised", zorder=3)
        curves = [(x, exact), (x, approximate)]
        differences = [(x, approximate - exact)]
        name = "Schlick"
        if critical is not None:
            name = "Schlick, incident angle"
            mended = schlick(np.nan_to_num(refraction_angle(theta, n_i, n_t), nan=RIGHT_ANGLE), r0)
            curves.append((x, mended))
            differences.append((x, mended - exact))
        lines = [
            (name, {"color": VERMILLION, "linestyle": "--", "linewidth": 2.2}),
            ("Schlick, transmitted angle", {"color": BLUE, "linestyle": (0, (1.2, 1.2)), "linewidth": 2.6}),
        ]
        for (label, look), curve, difference in zip(lines, curves[1:], differences, strict=False):
            above.plot(*curve, label=label, zorder=4, **look)
            below.plot(*difference, zorder=4, **look)
        _heading(above, _title("Schlick's approximation", n_i, n_t, from_name, to_name))

        below.axhline(0, color=BLACK, linewidth=0.9, zorder=2)
        below.set_ylabel("Schlick minus exact")
        lowest = min(float(np.min(d)) for _, d in differences)
        highest = max(float(np.max(d)) for _, d in differences)
        margin = max(0.16 * (highest - lowest), 1e-6)  # not so far in that rounding errors look like a result
        below.set_ylim(lowest - margin, highest + margin)
        figure.align_ylabels()

        labels = _Labels(above, curves)
        labels.add(f"normal incidence\n$R_0$ = {_g(r0, 5)}", (0, r0))
        if critical is not None:
            labels.add(f"critical angle {_degrees(critical)}", (np.degrees(critical), 1))
        _shade_total_reflection(above, critical, True, labels)

        labels = _Labels(below, [*differences, (np.array([0.0, 90.0]), np.zeros(2))])
        text = f"largest absolute error {_g(worst.absolute, 4)}\nat {_degrees(worst.theta, 4)}"
        labels.add(text, (np.degrees(worst.theta), worst.schlick - worst.exact))
        if critical is not None:
            # The same rays the other way: same reflectance, same angle in Schlick's formula, same error.
            other = schlick_error(n_t, n_i)
            at = float(refraction_angle(other.theta, n_t, n_i))
            text = f"with transmitted angle {_g(other.absolute, 4)}\nat {_degrees(at, 4)}"
            labels.add(text, (np.degrees(at), other.schlick - other.exact))
        _shade_total_reflection(below, critical, False, labels)
        return figure


def save(figure: Figure, stem: str | Path) -> list[Path]:
    """Write ``figure`` to ``stem``.png and ``stem``.svg and return the two paths.

    The same figure gives the same bytes on every run. Raises :class:`LightdomeError` if a file
    cannot be written.
    """
    stem = Path(stem)
    paths = [stem.with_name(f"{stem.name}.{kind}") for kind in ("png", "svg")]
    for path in paths:
        plotting.save_figure(figure, path, DPI, **_STYLE)
    return paths
