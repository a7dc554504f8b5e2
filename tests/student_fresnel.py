"""A student's Fresnel equations in numpy, independent of lightdome, with mistakes on request."""

from __future__ import annotations

import numpy as np


def curves(degrees: np.ndarray, eta: float, leaving: bool, mistake: str = "") -> dict[str, np.ndarray]:
    """The reflectances of unpolarised, p- and s-polarised light at angles in degrees."""
    n_i, n_t = (eta, 1.0) if leaving else (1.0, eta)
    if mistake == "eta inverted":
        n_i, n_t = n_t, n_i
    if mistake == "another refractive index":
        n_i, n_t = (n * 1.1 if n != 1 else n for n in (n_i, n_t))
    theta = np.radians(degrees)
    if mistake == "degrees used as radians":
        theta = degrees
    if mistake == "radians converted twice":
        theta = np.radians(theta)
    sine_t = n_i / n_t * np.sin(theta)
    all_of_it = np.abs(sine_t) >= 1
    cosine, cosine_t = np.cos(theta), np.sqrt(np.maximum(0, 1 - sine_t**2))
    p = (n_t * cosine - n_i * cosine_t) / (n_t * cosine + n_i * cosine_t)
    s = (n_i * cosine - n_t * cosine_t) / (n_i * cosine + n_t * cosine_t)
    beyond = np.nan if mistake == "curve ends at the critical angle" else 1.0
    p, s = np.where(all_of_it, beyond, p), np.where(all_of_it, beyond, s)
    result = {"reflectance": (p**2 + s**2) / 2, "p": p**2, "s": s**2}
    if mistake == "p and s swapped":
        result["p"], result["s"] = result["s"], result["p"]
    if mistake == "amplitudes averaged":
        result["reflectance"] = ((p + s) / 2) ** 2
    if mistake == "amplitudes not squared":
        result = {"reflectance": np.abs(p + s) / 2, "p": np.abs(p), "s": np.abs(s)}
    if mistake == "one polarisation for both":
        result["reflectance"] = result["p"]
    if mistake == "p and s added":
        result["reflectance"] = result["p"] + result["s"]
    if mistake == "transmittance for reflectance":
        result = {name: 1 - values for name, values in result.items()}
    if mistake == "percent":
        result = {name: 100 * values for name, values in result.items()}
    if mistake.startswith("Schlick"):
        r0 = ((n_i - n_t) / (n_i + n_t)) ** 2
        seen = cosine_t if leaving and mistake == "Schlick for Fresnel" else cosine
        result = {"reflectance": r0 + (1 - r0) * (1 - seen) ** 5}
    return result
