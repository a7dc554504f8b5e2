"""A student's median cut in numpy, independent of lightdome, with mistakes on request."""

from __future__ import annotations

import numpy as np


def cut(radiance: np.ndarray, count: int, mistake: str = "") -> tuple[np.ndarray, np.ndarray]:
    """The directions (N, 3) and fluxes (N, 3) of lights for a map (H, W, 3); ``count`` is a power of two."""
    L = radiance.astype(np.float64)
    if mistake == "map clipped to 1":
        L = np.minimum(L, 1)
    if mistake == "map gamma-encoded":
        L = L ** (1 / 2.2)
    height, width = L.shape[:2]
    theta = np.pi * (np.arange(height) + 0.5) / height
    sine = np.ones(height) if mistake == "no sin(theta)" else np.sin(theta)
    area = 2 * np.pi**2 / height / width
    if mistake == "solid angle missing":
        area = 1
    if mistake == "sin(theta) twice":
        sine = sine**2
    flux = L * (sine * area)[:, None, None]
    phi = 2 * np.pi * (np.arange(width) + 0.5) / width
    at_theta, at_phi = theta[:, None], phi[None]
    if mistake == "theta over half its range":
        at_theta = at_theta / 2
    if mistake == "phi over half its range":
        at_phi = at_phi / 2
    if mistake == "x and y swapped":
        at_theta, at_phi = phi[None] / 2, 2 * theta[:, None]
    parts = np.sin(at_theta) * np.cos(at_phi), np.cos(at_theta), np.sin(at_theta) * np.sin(at_phi)
    towards = np.stack(np.broadcast_arrays(*parts), axis=2)
    energy = flux.sum(axis=2)
    regions = [(0, height, 0, width)]
    while len(regions) < count:
        halves = []
        for y0, y1, x0, x1 in regions:
            middle = np.pi * (y0 + y1) / 2 / height
            wide = (x1 - x0) * (2 * np.pi / width) * np.sin(middle) > (y1 - y0) * np.pi / height
            wide = (wide and x1 - x0 > 1) or y1 - y0 < 2
            part = np.cumsum(energy[y0:y1, x0:x1].sum(axis=0 if wide else 1))
            if len(part) < 2:
                halves.append((y0, y1, x0, x1))
                continue
            at = int(np.abs(part[:-1] - part[-1] / 2).argmin()) + 1
            end = at + (mistake == "cut line in both halves")
            start = at + (mistake == "cut line in neither half" and at + 1 < len(part))
            if wide:
                halves += [(y0, y1, x0, x0 + end), (y0, y1, x0 + start, x1)]
            else:
                halves += [(y0, y0 + end, x0, x1), (y0 + start, y1, x0, x1)]
        if len(halves) == len(regions):
            break
        regions = halves
    direction, strength = [], []
    for y0, y1, x0, x1 in regions:
        part = flux[y0:y1, x0:x1]
        of = (part.sum(axis=2, keepdims=True) * towards[y0:y1, x0:x1]).sum(axis=(0, 1))
        if of.any():
            direction.append(of / np.linalg.norm(of))
            strength.append(part.sum(axis=(0, 1)))
    direction, strength = np.array(direction), np.array(strength)
    if mistake == "flux normalised away":
        strength = strength / strength.sum()
    if mistake == "pi missing":
        strength = strength / np.pi
    if mistake == "flux scaled":
        strength = strength * 5
    if mistake == "channels swapped":
        strength = strength[:, ::-1]
    if mistake == "directions not normalised":
        direction = direction * 0.8
    if mistake == "mirrored left to right":
        direction = direction * [-1, 1, 1]
    if mistake == "upside down":
        direction = direction * [1, -1, 1]
    if mistake == "directions point away from the light":
        direction = -direction
    if mistake == "wrong directions":
        direction = np.roll(direction, 5, axis=0)
    return direction, strength
