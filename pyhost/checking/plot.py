"""Plot the result of :mod:`lightdome.checking.image`: the image, the exact one, and their difference."""

from __future__ import annotations

import textwrap

import numpy as np

from .. import plotting  # first: it imports matplotlib

# isort: split
from matplotlib.figure import Figure

from ..disc import disc_mask
from ..maps.images import auto_exposure, tone_map
from .image import ImageCheck


@plotting.plain()
def error_map(check: ImageCheck, name: str) -> Figure:
    """The verdict above three pictures: the image, the exact one, and the error, blue: too dark, red: too bright."""
    outside = ~disc_mask(len(check.exact))
    error = np.where(outside, np.nan, (check.image - check.exact).mean(axis=2))
    most = float(np.nanpercentile(np.abs(error), 99.5)) or 1e-30
    exposure = auto_exposure(check.exact)
    figure = Figure(figsize=(13, 5), layout="constrained")
    figure.suptitle(plotting.text("\n".join(textwrap.wrap(check.verdict, 150)[:3])), fontsize=10)
    axes = figure.subplots(1, 3)
    for plot, (title, pixels) in zip(axes[:2], ((name, check.image), ("exact", check.exact)), strict=True):
        plot.imshow(tone_map(np.where(outside[..., None], 0, pixels), exposure))
        plot.set_title(plotting.text(title), fontsize=9)
    drawn = axes[2].imshow(error, cmap="RdBu_r", vmin=-most, vmax=most)
    axes[2].set_title("image - exact, mean of the channels: red is too bright", fontsize=9)
    figure.colorbar(drawn, ax=axes[2], shrink=0.8, extend="both", label="radiance")
    for plot in axes:
        plot.set_axis_off()
    return figure
