"""A correct solution of the exercise in docs/teaching/starter.py, in numpy only."""

from __future__ import annotations

import numpy as np


def fresnel(angle: np.ndarray, eta_from: float, eta_to: float) -> tuple[np.ndarray, np.ndarray]:
    cosine = np.cos(angle)
    sine_behind = eta_from / eta_to * np.sin(angle)
    behind = np.sqrt(np.maximum(0, 1 - sine_behind**2))
    p = (eta_to * cosine - eta_from * behind) / (eta_to * cosine + eta_from * behind)
    s = (eta_from * cosine - eta_to * behind) / (eta_from * cosine + eta_to * behind)
    total = sine_behind >= 1
    return np.where(total, 1.0, p**2), np.where(total, 1.0, s**2)


def _weights(radiance: np.ndarray) -> np.ndarray:
    theta = np.pi * (np.arange(len(radiance)) + 0.5) / len(radiance)
    return radiance.mean(axis=2) * np.sin(theta)[:, None]


def sample(radiance: np.ndarray, count: int, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    weight = _weights(radiance)
    marginal, rows = np.cumsum(weight.sum(axis=1)), np.cumsum(weight, axis=1)
    y = np.searchsorted(marginal, random.random(count) * marginal[-1], side="right")
    u = random.random(count) * rows[y, -1]
    x = np.empty(count, np.int64)
    for row in np.unique(y):
        here = y == row
        x[here] = np.searchsorted(rows[row], u[here], side="right")
    return np.stack([x, y], axis=1), weight[y, x] / weight.sum()


def _lights(radiance: np.ndarray, pixel: np.ndarray, probability: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    height, width = radiance.shape[:2]
    x, y = pixel[:, 0], pixel[:, 1]
    theta, phi = np.pi * (y + 0.5) / height, 2 * np.pi * (x + 0.5) / width
    direction = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)], axis=1)
    solid_angle = 2 * np.pi / width * 2 * np.sin(np.pi / (2 * height)) * np.sin(theta)
    return direction, radiance[y, x] * (solid_angle / probability)[:, None]


def _sphere(resolution: int) -> tuple[np.ndarray, np.ndarray]:
    a = (2 * np.arange(resolution) + 1 - resolution) / resolution
    x, y = np.meshgrid(a, -a)
    inside = x**2 + y**2 < 1
    return inside, np.stack([x, y, np.sqrt(np.maximum(0, 1 - x**2 - y**2))], axis=2)[inside]


def shade(radiance: np.ndarray, pixel: np.ndarray, probability: np.ndarray, resolution: int) -> np.ndarray:
    direction, light = _lights(radiance, pixel, probability)
    inside, normal = _sphere(resolution)
    image = np.zeros((resolution, resolution, 3))
    image[inside] = np.maximum(0, normal @ direction.T) @ light / (np.pi * len(pixel))
    return image


def render(radiance: np.ndarray, spp: int, resolution: int, random: np.random.Generator) -> np.ndarray:
    inside, normal = _sphere(resolution)
    direction, light = _lights(radiance, *sample(radiance, spp * len(normal), random))
    cosine = np.maximum(0, (np.repeat(normal, spp, axis=0) * direction).sum(axis=1))
    image = np.zeros((resolution, resolution, 3))
    image[inside] = (cosine[:, None] * light).reshape(len(normal), spp, 3).mean(axis=1) / np.pi
    return image
