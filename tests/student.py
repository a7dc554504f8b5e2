"""A student's renderer of the diffuse sphere in numpy, with mistakes on request."""

from __future__ import annotations

import numpy as np

# Each mistake, and what the verdict on its image must say.
MISTAKES = {
    "no sine": "no sin(theta)",
    "sine twice": "sin(theta) twice",
    "half theta": "theta over half its range",
    "twice theta": "theta over twice its range",
    "half phi": "phi over half its range",
    "p for density": "p of a pixel used as a density",
    "no flux": "the total flux of the map is missing",
    "no pi": "the 1 / pi of the BRDF is missing",
    "pi twice": "divided by pi twice",
    "no albedo over pi": "albedo / pi is missing",
    "map clipped": "map clipped to 1:",
    "map clipped to 255": "map clipped to 255:",
    "Rec. 709": "luminance of Rec. 709",
    "mirrored": "mirrored left to right",
    "phi backwards": "mirrored front to back",
    "upside down": "upside down",
    "rows upside down": "upside down",
    "yaw": "turned by 270 degrees about the vertical",
    "x and y swapped": "x and y swapped",
    "edges": "pixel edges for centres",
    "W - 1": "W - 1 for W",
    "one number": "one random number for row and column",
    "CDF from row 1": "CDF starts at row 1",
    "CDF sorted": "CDF sorted",
    "zero weights": "agrees",  # it makes a difference only where a random number is exactly 0, so no image shows it
    "other row": "row CDF of another row",
    "map encoded": "map gamma-encoded",
    "map decoded": "gamma decoded from linear values",
    "image encoded": "image gamma-encoded",
    "image clipped": "image clipped to 1",
    "channels swapped": "channels swapped",
    "cosine not clamped": "cosine not clamped",
    "absolute cosine": "absolute cosine",
    "flat normals": "normals not normalised",
    "normals without root": "normals without square root",
}
ALBEDO = {"no albedo over pi": 0.6}  # a white sphere does not show this mistake


def render(
    radiance: np.ndarray, count: int, side: int, seed: int = 0, mistake: str = "", albedo: float = 1.0
) -> np.ndarray:
    """The sphere lit by ``count`` samples that all pixels share: (side, side, 3) float32.

    ``mistake`` is a name of :data:`MISTAKES`, or several with " + " between them.
    """
    made = frozenset(mistake.split(" + "))
    L = radiance.astype(np.float64)
    if "map clipped" in made:
        L = np.minimum(L, 1)
    if "map clipped to 255" in made:
        L = np.minimum(L, 255)
    if "map encoded" in made:
        L = L ** (1 / 2.2)
    if "map decoded" in made:
        L = L**2.2
    if "phi backwards" in made:
        L = L[:, ::-1]
    if "upside down" in made:
        L = L[::-1]
    if "channels swapped" in made:
        L = L[..., ::-1]
    if "yaw" in made:
        L = np.roll(L, L.shape[1] // 4, axis=1)
    height, width = L.shape[:2]
    rng = np.random.default_rng(seed)
    u, v = rng.random(count), rng.random(count)
    y, x, weight = _pixels(L, u, u if "one number" in made else v, made)

    sine = np.sin(np.pi * (np.arange(height) + 0.5) / height)
    area = 2 * np.pi / width * 2 * np.sin(np.pi / 2 / height) * sine
    I = L.mean(axis=2)  # noqa: E741 - the formula's name
    flux = (I * area[:, None]).sum()
    drawn, times = np.unique(y * width + x, return_counts=True)
    y, x = drawn // width, drawn % width
    with np.errstate(all="ignore"):
        term = np.nan_to_num(L[y, x] / I[y, x, None]) * flux / count
        if "p for density" in made:
            term = L[y, x] / (weight[y, x] / weight.sum())[:, None] / count
        if "no flux" in made:
            term /= flux
    image = _shade(_directions(y, x, height, width, made), term * times[:, None], side, made)
    image *= albedo / np.pi
    if "no pi" in made:
        image *= np.pi
    if "pi twice" in made:
        image /= np.pi
    if "no albedo over pi" in made:
        image *= np.pi / albedo
    if "image encoded" in made:
        image = np.maximum(image, 0) ** (1 / 2.2)
    if "image clipped" in made:
        image = np.minimum(image, 1)
    if "rows upside down" in made:
        image = image[::-1]
    if "mirrored" in made:
        image = image[:, ::-1]
    return image.astype(np.float32)


def _pixels(L: np.ndarray, u: np.ndarray, v: np.ndarray, made: frozenset[str]) -> tuple[np.ndarray, ...]:
    """The rows and columns drawn, and the weights by which they are drawn."""
    height, width = L.shape[:2]
    weight = L @ np.array([0.2126, 0.7152, 0.0722]) if "Rec. 709" in made else L.mean(axis=2)
    power = 0 if "no sine" in made else 2 if "sine twice" in made else 1
    weight = weight * np.sin(np.pi * (np.arange(height) + 0.5) / height)[:, None] ** power
    if "CDF sorted" in made:
        weight = np.sort(weight, axis=1)
    side = "left" if "zero weights" in made else "right"
    rows = np.cumsum(weight.sum(axis=1))
    y = np.searchsorted(rows / rows[-1], u, side=side).clip(max=height - 1)
    of_row = (y + 1) % height if "other row" in made else y
    within = np.cumsum(weight, axis=1)
    within = np.where(within[:, -1:] > 0, within / np.maximum(within[:, -1:], 1e-300), np.arange(1, width + 1) / width)
    flat = (within + np.arange(height)[:, None]).reshape(-1)
    x = (np.searchsorted(flat, of_row + v, side=side) - of_row * width).clip(0, width - 1)
    if "CDF from row 1" in made:
        y = (y + 1) % height
    return y, x, weight


def _directions(y: np.ndarray, x: np.ndarray, height: int, width: int, made: frozenset[str]) -> np.ndarray:
    theta, phi = np.pi * (y + 0.5) / height, 2 * np.pi * (x + 0.5) / width
    if "edges" in made:
        theta, phi = np.pi * y / height, 2 * np.pi * x / width
    if "W - 1" in made:
        theta, phi = np.pi * y / (height - 1), 2 * np.pi * x / (width - 1)
    if "half theta" in made:
        theta = theta / 2
    if "twice theta" in made:
        theta = theta * 2
    if "half phi" in made:
        phi = phi / 2
    if "x and y swapped" in made:
        theta, phi = np.pi * (x + 0.5) / width, 2 * np.pi * (y + 0.5) / height
    return np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)], axis=1)


def _shade(direction: np.ndarray, flux: np.ndarray, side: int, made: frozenset[str]) -> np.ndarray:
    """The image (side, side, 3) of sums of flux x cosine."""
    a = (2 * np.arange(side) + 1 - side) / side
    x, y = np.meshgrid(a, -a)
    inside = x**2 + y**2 < 1
    normal = np.stack([x, y, np.sqrt(np.maximum(0, 1 - x**2 - y**2))], axis=-1)[inside]
    if "flat normals" in made:
        normal[:, 2] = 1
    if "normals without root" in made:
        normal[:, 2] **= 2
    pixels = []
    for part in np.array_split(normal, 1 + len(normal) // 64):
        cosine = part @ direction.T
        if "absolute cosine" in made:
            cosine = np.abs(cosine)
        elif "cosine not clamped" not in made:
            cosine = np.maximum(0, cosine)
        pixels.append(cosine @ flux)
    image = np.zeros((side, side, 3))
    image[inside] = np.concatenate(pixels)
    return image
