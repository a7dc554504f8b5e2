"""Plot the error of each pixel of an image, as an estimate without the exact image has it."""

from __future__ import annotations

import numpy as np

from .. import plotting  # first: it imports matplotlib

# isort: split
from matplotlib.figure import Figure

from ..disc import disc_mask


@plotting.plain()
def error_figure(error: np.ndarray, rmse: float) -> Figure:
    """``error``, (R, R) radiance, in false colour; ``rmse`` is its relative RMSE."""
    inside = disc_mask(len(error))
    most = float(np.percentile(error[inside], 99.5)) or 1e-30
    figure = Figure(figsize=(6, 5), layout="constrained")
    plot = figure.subplots()
    drawn = plot.imshow(np.where(inside, error, np.nan), cmap="viridis", vmin=0, vmax=most)
    figure.colorbar(drawn, ax=plot, shrink=0.9, extend="max", label="radiance")
    of_all = f"{100 * rmse:.3g} %" if np.isfinite(rmse) else "unknown"
    plot.set_title(f"error of each pixel; relative RMSE {of_all}", fontsize=10)
    plot.set_axis_off()
    return figure
