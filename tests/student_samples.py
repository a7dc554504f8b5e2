"""A student's sampler in numpy, independent of lightdome, with mistakes on request."""

from __future__ import annotations

import numpy as np


def luminance(radiance: np.ndarray, mistake: str = "") -> np.ndarray:
    """(R + G + B) / 3 of a map (H, W, 3), float64."""
    if mistake == "luminance of Rec. 709":
        return radiance @ np.array([0.2126, 0.7152, 0.0722])
    if mistake == "largest channel for the mean":
        return radiance.max(axis=2)
    if mistake == "one channel for the mean":
        return radiance[..., 1]
    return radiance.sum(axis=2) / 3


def draw(radiance: np.ndarray, points: np.ndarray, mistake: str = "", within: bool = False) -> dict[str, np.ndarray]:
    """A sample for each of ``points`` (N, 2): its direction, radiance, probability, pixel and density per steradian."""
    L = radiance.astype(np.float64)
    if mistake == "map clipped to 1":
        L = np.minimum(L, 1)
    if mistake == "map clipped to 255":
        L = np.minimum(L, 255)
    if mistake == "map gamma-encoded":
        L = L ** (1 / 2.2)
    if mistake == "gamma decoded from linear values":
        L = L**2.2
    if mistake == "channels swapped":
        L = L[..., ::-1]
    height, width = L.shape[:2]
    theta = np.pi * (np.arange(height) + 0.5) / height
    weight = luminance(L, mistake)
    if mistake != "no sin(theta)":
        weight = weight * np.sin(theta)[:, None]
    if mistake == "sin(theta) twice":
        weight = weight * np.sin(theta)[:, None]
    if mistake == "CDF sorted":
        weight = np.sort(weight, axis=1)
    rows = weight.sum(axis=1)
    if mistake == "rows drawn evenly":
        rows = (rows > 0).astype(float)
    row_cdf = np.cumsum(rows) / rows.sum()
    u, v = points.T
    if mistake == "one random number for row and column":
        u = v
    y = np.minimum(np.searchsorted(row_cdf, v, side="right"), height - 1)
    if mistake == "CDF starts at row 1":
        y = np.minimum(y + 1, height - 1)
    of = (y + 1) % height if mistake == "row CDF of another row" else y
    cdf = np.cumsum(weight, axis=1)
    with np.errstate(invalid="ignore"):
        cdf /= cdf[:, -1:]
    x = np.array([np.searchsorted(cdf[row], at, side="right") for row, at in zip(of, u, strict=True)])
    if mistake == "column found one too far":
        x += 1
    if mistake == "columns drawn evenly":
        x = (u * width).astype(int)
    if mistake == "zero-weight pixels drawn":  # as >= finds them for random numbers equal to an entry of the CDF
        few = np.arange(len(u)) % 50 == 0
        x[few], y[few] = np.argwhere(weight == 0)[0][::-1]
    x = x % width
    p = weight / weight.sum()
    if mistake == "rows drawn evenly":
        p = weight / np.maximum(weight.sum(axis=1, keepdims=True), 1e-300) * (rows / rows.sum())[:, None]
    if mistake == "columns drawn evenly":
        p = np.repeat((rows / rows.sum() / width)[:, None], width, axis=1)
    probability = p[y, x]
    area = 2 * np.pi / width * (np.cos(np.pi * y / height) - np.cos(np.pi * (y + 1) / height))
    pdf = probability / area
    if mistake == "density for probability":
        probability = pdf
    if mistake == "solid angle missing":
        pdf = probability
    if mistake == "density over the map":
        pdf = probability * width * height
    if mistake == "probability of the row alone":
        probability = p.sum(axis=1)[y]
    if mistake == "probability of the column alone":
        probability = p[y, x] / p.sum(axis=1)[y]
    if mistake == "not normalised":
        probability = weight[y, x]
    a, b = np.full((2, len(y)), 0.5)
    if within:
        rng = np.random.default_rng(7)
        a, b = rng.random((2, len(y)))
    at_theta, at_phi = np.pi * (y + a) / height, 2 * np.pi * (x + b) / width
    if mistake == "theta over half its range":
        at_theta = at_theta / 2
    if mistake == "phi over half its range":
        at_phi = at_phi / 2
    if mistake == "x and y swapped":
        at_theta, at_phi = np.pi * (x + a) / width, 2 * np.pi * (y + b) / height
    if mistake == "pixel edges for centres":
        at_theta, at_phi = np.pi * y / height, 2 * np.pi * x / width
    if mistake == "W - 1 for W":
        at_theta, at_phi = np.pi * y / (height - 1), 2 * np.pi * x / (width - 1)
    sine = np.sin(at_theta)
    direction = np.stack([sine * np.cos(at_phi), np.cos(at_theta), sine * np.sin(at_phi)], axis=1)
    if mistake == "directions not normalised":
        direction = direction * 1.7
    of_pixels = L[y, x]
    if mistake == "radiance of other pixels":
        of_pixels = L[(y + height // 3) % height, (x * 7 + 3) % width]
    if mistake == "radiance scaled":
        of_pixels = of_pixels * 0.18
    pixel = np.stack([y, x] if mistake == "pixel of another convention" else [x, y], axis=1)
    result = {"direction": direction, "radiance": of_pixels, "probability": probability, "pixel": pixel, "pdf": pdf}
    if mistake == "samples repeated":
        result = {name: np.concatenate([values[: len(values) // 16]] * 16) for name, values in result.items()}
    return result
