"""Find the sphere in another program's image."""

from __future__ import annotations

import numpy as np

MAX_SIDE = 511  # pixels, of the images that are compared


def find_disc(image: np.ndarray) -> tuple[float, float, float]:
    """The centre (x, y) and radius of a sphere on a black background, in pixels from the upper left corner.

    The sphere is the smallest circle around everything that is not black. That is right for a sphere lit from one side
    too, since the two ends of its terminator are opposite each other. Without a black background it is the largest
    circle in the middle of the image.
    """
    height, width = image.shape[:2]
    whole = width / 2, height / 2, min(height, width) / 2
    lit = (image != 0).any(axis=2)
    rows = np.flatnonzero(lit.any(axis=1))
    if len(rows) < 3 or lit.mean() > 0.95:
        return whole
    first, last = lit.argmax(axis=1)[rows], width - 1 - lit[:, ::-1].argmax(axis=1)[rows]
    points = np.concatenate([np.stack([x, rows], axis=1) for x in (first, last)], dtype=np.float64)
    points += 0.5
    centre = points.mean(axis=0)
    for step in range(1, 5000):  # Badoiu and Clarkson (2003)
        away = points - centre
        furthest = int((away**2).sum(axis=1).argmax())
        centre = centre + away[furthest] / (step + 1)
    radius = float(np.sqrt(((points - centre) ** 2).sum(axis=1).max())) + 0.05
    # Only pixel centres were fitted, so a circle within about a pixel of the image's own is that one.
    if max(abs(centre[0] - whole[0]), abs(centre[1] - whole[1]), abs(radius - whole[2])) < 1.5:
        return whole
    diameter, corner = round(2 * radius), np.round(centre - radius)
    snapped = corner + diameter / 2
    if abs(diameter - 2 * radius) < 0.6 and np.abs(snapped - centre).max() < 0.3:  # an image pasted into another
        return float(snapped[0]), float(snapped[1]), diameter / 2
    return float(centre[0]), float(centre[1]), radius


def seen_in(image: np.ndarray, disc: tuple[float, float, float]) -> np.ndarray:
    """The square around the sphere, (R, R, 3); if R would exceed :data:`MAX_SIDE`, only every n-th pixel is taken."""
    x, y, radius = disc
    diameter = round(2 * radius) if abs(2 * radius - round(2 * radius)) <= 1e-9 else 2 * round(radius)
    stride = -(-diameter // MAX_SIDE)
    side = diameter // stride
    scale = 2 * radius / side
    across = x - radius + scale * (np.arange(side) + 0.5) - 0.5
    down = y - radius + scale * (np.arange(side) + 0.5) - 0.5
    if stride > 1 or (np.abs(across - np.round(across)).max() < 1e-6 and np.abs(down - np.round(down)).max() < 1e-6):
        rows, columns = (
            np.clip(np.round(v).astype(int), 0, n - 1) for v, n in zip((down, across), image.shape, strict=False)
        )
        return image[rows[:, None], columns].astype(np.float64)

    def spans(at: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        first = np.clip(np.floor(at).astype(int), 0, max(count - 2, 0))
        return first, np.minimum(first + 1, count - 1), np.clip(at - first, 0, 1)

    y0, y1, v = spans(down, image.shape[0])
    x0, x1, u = spans(across, image.shape[1])
    v, u = v[:, None, None], u[None, :, None]
    wide = image.astype(np.float64)
    upper = wide[y0[:, None], x0] * (1 - u) + wide[y0[:, None], x1] * u
    lower = wide[y1[:, None], x0] * (1 - u) + wide[y1[:, None], x1] * u
    return upper * (1 - v) + lower * v
