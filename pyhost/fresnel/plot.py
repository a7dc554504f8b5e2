"""Figures of Fresnel reflectance and of Schlick's approximation, with their characteristic points labelled.

:func:`fresnel_figure` shows both polarisations and unpolarised light for one direction through a
boundary, :func:`schlick_figure` the approximation beside the exact curve and their difference; :func:`save`
writes a figure as PNG and SVG. Lines differ in colour (Okabe and Ito's palette, safe for colour-blind
readers), in style and in width, so that they also differ in grey.

Labels stand in margins below and above the curves, and beside the critical angle on the side that has more room. For
indices from 1.05 to 4, no curve runs there. pyplot is not used: figures are plain objects, no window opens, and no
state is left behind.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from .. import plotting  # first: it imports matplotlib

# isort: split
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

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
BELOW = -0.14  # the height of labels below curves of reflectance

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


def _label(
    ax: Axes, text: str, point: tuple[float, float], at: tuple[float, float], align: str, relpos: tuple[float, float]
) -> None:
    """Mark ``point``, and write ``text`` at the point ``at``, with an arrow from ``relpos`` of its box."""
    arrow = {"arrowstyle": "-|>", "color": BLACK, "linewidth": 0.9, "shrinkA": 2, "shrinkB": 3, "relpos": relpos}
    look: dict[str, Any] = {"ha": align, "va": "center", "fontsize": 10.5, "linespacing": 1.35, "zorder": 6}
    ax.annotate(text, point, at, arrowprops=arrow, **look)
    ax.plot(*point, "o", color=BLACK, markersize=5, clip_on=False, zorder=7)


def _label_beside(ax: Axes, text: str, point: tuple[float, float], y: float) -> None:
    """Label ``point`` at the height ``y``, to the left of a point in the right half, else to the right."""
    if point[0] > 45:
        _label(ax, text, point, (point[0] - 3, y), "right", (1, 0.5))
    else:
        _label(ax, text, point, (point[0] + 3, y), "left", (0, 0.5))


def _label_normal_incidence(ax: Axes, equals: str, r0: float) -> None:
    _label(ax, f"normal incidence\n{equals} = {_g(r0, 5)}", (0, r0), (1.5, BELOW), "left", (0, 1))


def _angles(n_i: float, n_t: float) -> np.ndarray:
    """Angles of incidence in radians, dense enough to draw every bend of the curves for this boundary."""
    even = np.linspace(0, RIGHT_ANGLE, 1001)
    marks = [a for a in (brewster_angle(n_i, n_t), critical_angle(n_i, n_t)) if a is not None]
    if n_i > n_t:  # curves are infinitely steep at the critical angle, so more angles are needed there
        marks += list(refraction_angle(even, n_t, n_i))
    return np.union1d(even, marks)


def _g(value: float, digits: int) -> str:
    """A number with this many digits; a power of ten is written as in mathematics."""
    mantissa, _, exponent = f"{value:#.{digits}g}".partition("e")
    return rf"${mantissa} \times 10^{{{int(exponent)}}}$" if exponent else mantissa


def _degrees(angle: float, digits: int = 6) -> str:
    return f"{_g(np.degrees(angle), digits)}°"


def _title(what: str, n_i: float, n_t: float, from_name: str, to_name: str) -> str:
    return f"{what}: {from_name} ($n_i$ = {exactly(n_i)}) to {to_name} ($n_t$ = {exactly(n_t)})"


def _figure(height: float, rows: list[float]) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(9.0, height))
    FigureCanvasAgg(figure)
    grid = {"height_ratios": rows, "left": 0.11, "right": 0.97, "hspace": 0.12}
    grid |= {"bottom": 0.62 / height, "top": 1 - 0.85 / height}
    axes = figure.subplots(len(rows), 1, sharex=True, gridspec_kw=grid, squeeze=False)[:, 0]
    for ax in axes:
        ax.set_xlim(0, 90)
        ax.set_xticks(np.arange(0, 91, 10))
    axes[-1].set_xlabel("angle of incidence (degrees)")
    axes[0].set_ylabel("reflectance (fraction of incident power)")
    axes[0].set_ylim(-0.26, 1.04)
    axes[0].set_yticks(np.linspace(0, 1, 6))
    return figure, list(axes)


def _heading(ax: Axes, title: str) -> None:
    """Title and legend above the axes, where no curve can run through them."""
    ax.set_title(title, pad=34)
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 0.995), ncols=3, handlelength=3.4, columnspacing=2.2)


def _shade_total_reflection(ax: Axes, critical: float | None) -> None:
    if critical is not None:
        ax.axvspan(np.degrees(critical), 90, color=GREY, zorder=0, linewidth=0)


def _label_critical_angle(ax: Axes, critical: float | None, more: str = "") -> None:
    """Label the critical angle, and the total reflection beyond it."""
    if critical is None:
        return
    start = np.degrees(critical)
    _label_beside(ax, f"critical angle {_degrees(critical)}{more}", (start, 1), 0.87)
    if start < 73:
        # Near the top, which Schlick's curve reaches last; lower if the critical angle's label is on this side.
        look: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 10.5, "linespacing": 1.35}
        ax.text((start + 90) / 2, 0.87 if start > 45 else 0.65, "total internal\nreflection", **look)


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

        critical, brewster = critical_angle(n_i, n_t), brewster_angle(n_i, n_t)
        _label_normal_incidence(ax, "$R_p$ = $R_s$", normal_reflectance(n_i, n_t))
        if brewster is not None:
            at = np.degrees(brewster)
            text = f"Brewster's angle {_degrees(brewster)}\n$R_p$ = 0"
            _label(ax, text, (at, 0), (np.clip(at, 36, 77), BELOW), "center", (0.5, 1))
        _label_critical_angle(ax, critical, "\nall reflected beyond")
        _shade_total_reflection(ax, critical)
        return figure


def schlick_figure(n_i: float, n_t: float, from_name: str = "side i", to_name: str = "side t") -> Figure:
    """Schlick's approximation beside the exact reflectance of unpolarised light, and their difference.

    Arguments and errors as in :func:`fresnel_figure`. R0 and the largest absolute error are marked. For
    light that leaves the denser side the approximation is drawn twice: with the angle of incidence, as
    :func:`schlick_error` does, and with the angle of the transmitted light, which corrects it.
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
        curves = [(x, approximate)]
        differences = [(x, approximate - exact)]
        name = "Schlick"
        if critical is not None:
            name = "Schlick, incident angle"
            mended = schlick(np.nan_to_num(refraction_angle(theta, n_i, n_t), nan=RIGHT_ANGLE), r0)
            curves.append((x, mended))
            differences.append((x, mended - exact))
        lines: list[tuple[str, dict[str, Any]]] = [
            (name, {"color": VERMILLION, "linestyle": "--", "linewidth": 2.2}),
            ("Schlick, transmitted angle", {"color": BLUE, "linestyle": (0, (1.2, 1.2)), "linewidth": 2.6}),
        ]
        for (label, look), curve, difference in zip(lines, curves, differences, strict=False):
            above.plot(*curve, label=label, zorder=4, **look)
            below.plot(*difference, zorder=4, **look)
        _heading(above, _title("Schlick's approximation", n_i, n_t, from_name, to_name))

        below.axhline(0, color=BLACK, linewidth=0.9, zorder=2)
        below.set_ylabel("Schlick minus exact")
        lowest = min(float(np.min(d)) for _, d in differences)
        highest = max(float(np.max(d)) for _, d in differences)
        margin = max(0.22 * (highest - lowest), 1e-6)  # for labels; and rounding errors must not look like a result
        below.set_ylim(lowest - margin, highest + margin)
        figure.align_ylabels()

        _label_normal_incidence(above, "$R_0$", r0)
        _label_critical_angle(above, critical)

        # Labels stand above the curves, or one above and one below.
        high, low = highest + margin / 2, lowest - margin / 2
        # If both curves are drawn, each label says whose largest error it is.
        which = "largest absolute error" if critical is None else "incident angle: at most"
        text = f"{which} {_g(worst.absolute, 4)} at {_degrees(worst.theta, 4)}"
        at = (np.degrees(worst.theta), worst.schlick - worst.exact)
        _label_beside(below, text, at, high if critical is None else low)
        if critical is not None:
            # The same rays in the other direction: same reflectance, same angle in Schlick's formula, same error.
            other = schlick_error(n_t, n_i)
            angle = float(refraction_angle(other.theta, n_t, n_i))
            text = f"transmitted angle: at most {_g(other.absolute, 4)} at {_degrees(angle, 4)}"
            _label_beside(below, text, (np.degrees(angle), other.schlick - other.exact), high)
        for ax in (above, below):
            _shade_total_reflection(ax, critical)
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
