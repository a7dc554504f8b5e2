"""The numbers and curves of the Fresnel tab."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from .. import checks
from ..errors import LightdomeError
from ..fresnel import fresnel, schlick, summarise

ETAS = (1.0, 4.0)  # range of the slider
STEPS = 180  # of half a degree each


def reflectance(eta: object) -> dict[str, object]:
    """For a refractive index in air: :func:`lightdome.fresnel.summarise`, and reflectance by angle, both ways."""
    index = checks.real("eta", eta, "a finite number", -np.inf)
    if not ETAS[0] <= index <= ETAS[1]:
        raise LightdomeError(f"eta must be from {ETAS[0]:g} to {ETAS[1]:g}, got {index:g}")
    degrees = np.linspace(0, 90, STEPS + 1)
    theta = np.radians(degrees)
    theta[-1] = np.pi / 2
    summary = asdict(summarise(index))
    curves = {}
    for name, pair in {"entering": (1.0, index), "leaving": (index, 1.0)}.items():
        at = np.sort(np.append(theta, np.radians(summary[f"critical_{name}_deg"] or 0.0)))  # for the curve's corner
        p, s = fresnel(at, *pair)
        curves[name] = {
            "degrees": np.degrees(at).tolist(),
            "p": p.tolist(),
            "s": s.tolist(),
            "unpolarised": ((p + s) / 2).tolist(),
            "schlick": schlick(at, summary["schlick_r0"]).tolist(),
        }
    return {"summary": summary, "curves": curves}
