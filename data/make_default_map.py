#!/usr/bin/env python3
"""Make the default environment map: a vaulted chapel at dusk, ray traced with numpy.

The room is real geometry, defined by signed distances (positive in air) and rendered by sphere tracing: four
groin-vaulted bays with ribs and wall shafts, traceried windows, three lancets with the setting sun behind them, a rose
window, a tiled and slightly glossy floor, pews, an altar, lamps and candles. Light comes from the windows (each split
into patches), the lamps, and two bounces between patches of floor, walls and vault; a sunbeam through the lancets is
traced separately.

Coordinates are in metres from the camera: ``u`` along the nave towards the lancets, ``v`` across it, ``y`` up. The nave
runs along phi = 135 degrees, so that a diffuse sphere seen along -z has the warm lancets at its upper left and the cool
side windows at its right.

Everything is computed in float64 with + - * / sqrt and floor, which IEEE 754 rounds identically everywhere. The only
exceptions are the sines of the pixel angles, which are rounded to 2^-40. So every machine produces the same pixels.
"""

import os
import sys

sys.path.insert(0, os.path.dirname(os.path.realpath(__file__)) + "/../scripts")  # noqa: PTH120
import _start  # noqa: F401 - first, so that Ctrl-C is handled and .venv is found

# isort: split
import argparse
import math
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import reduce
from pathlib import Path

import numpy as np
from lightdome.console import run
from lightdome.errors import LightdomeError
from lightdome.files import replacing, utf8_name
from lightdome.interrupts import Unheard
from numpy.typing import NDArray

Array = NDArray[np.float64]

WIDTH, HEIGHT = 1024, 512
SUPERSAMPLES = 3  # per side: 9 rays per pixel

FLOOR = -1.6
HALF_WIDTH = 4.5
BAY = 4.5
BAYS = 4
EAST, WEST = 7.5, 7.5 - BAYS * BAY  # the wall with the lancets, the wall with the rose
SPRING = 3.0  # height where the vault springs
VAULT_RADIUS = 6.5  # two arcs make a pointed arch; both barrels have the same crown
CROSS_RADIUS = (VAULT_RADIUS**2 - (VAULT_RADIUS - HALF_WIDTH) ** 2 + (BAY / 2) ** 2) / BAY
ROSE_HEIGHT = 5.0
DEPTH = 0.45  # of a window's glass, behind the face of its wall

SUN = np.array([7.95, 2.42, 3.75]) / math.sqrt(7.95**2 + 2.42**2 + 3.75**2)  # (u, v, y): in a lancet
SUN_RADIANCE = np.array([760.0, 560.0, 300.0])
SUN_SPREAD = 2.2e-4  # 1 - cos(1.2 degrees): the glass blurs the disc
SUNBEAM = np.array([1.7, 1.2, 0.6])  # irradiance perpendicular to the beam, before the glass

STONE = np.array([0.22, 0.205, 0.185])
LAMP_RADIANCE = np.array([40.0, 20.0, 7.0])
LAMP_SIZE = 0.08
FLAME_RADIANCE = np.array([160.0, 92.0, 34.0])


# --- shapes ---------------------------------------------------------------------------------------


def length(x: Array, y: Array) -> Array:
    """The Euclidean length of (x, y)."""
    return np.sqrt(x * x + y * y)


def lancet(s: Array, y: Array, half: float, sill: float, spring: float) -> Array:
    """Distance inside a pointed window, with an equilateral arch of half width ``half`` above ``spring``."""
    return np.minimum(y - sill, 2 * half - length(np.abs(s) + half, np.maximum(y - spring, 0)))


def box(u: Array, v: Array, y: Array, half: tuple[float, float, float]) -> Array:
    """A lower bound of the distance to a box around the origin, negative inside."""
    return np.maximum(np.maximum(np.abs(u) - half[0], np.abs(v) - half[1]), np.abs(y) - half[2])


def bay_of(u: Array) -> Array:
    """The bay's number, 0 next to the lancets."""
    return np.clip(np.floor((EAST - u) / BAY), 0, BAYS - 1)


def fold12(v: Array, y: Array) -> tuple[Array, Array]:
    """Reflect the plane into one of the twelve petals of the rose, along the first axis."""
    a, b = np.maximum(np.abs(v), np.abs(y)), np.minimum(np.abs(v), np.abs(y))
    # An eighth of the circle remains, one and a half petals: reflect whatever is above 15 degrees.
    nx, ny = math.sin(math.pi / 12), -math.cos(math.pi / 12)
    over = 2 * np.maximum(-(a * nx + b * ny), 0)
    return a + over * nx, np.abs(b + over * ny)


def side_glass(s: Array, y: Array) -> Array:
    """Distance inside the openings of a side window: two lights under an oculus."""
    lights = lancet(np.abs(s) - 0.64, y, 0.54, 1.0, 3.95)
    return np.maximum(lights, 0.56 - length(s, y - 5.3))


def east_glass(v: Array, y: Array) -> Array:
    """Distance inside the three lancets and the roundel above them."""
    av = np.abs(v)
    lights = np.maximum(lancet(v, y, 0.95, 0.4, 5.0), lancet(av - 2.5, y, 0.78, 0.4, 3.8))
    return np.maximum(lights, 0.6 - length(v, y - 7.75))


def rose_glass(v: Array, y: Array) -> Array:
    """Distance inside the openings of the rose: an eye, twelve petals, twelve roundels."""
    a, b = fold12(v, y - ROSE_HEIGHT)
    eye = 0.52 - length(v, y - ROSE_HEIGHT)
    along = np.clip(a, 0.95, 1.62)
    petal = 0.06 + 0.155 * along - length(a - along, b)
    return np.maximum(np.maximum(eye, petal), 0.31 - length(a - 2.27, b))


# Kinds of surface: walls, floor, vault webs, glass; ribs and shafts; pews and door; altar; chains and candlesticks.
SHELL, RIBS, WOOD, CLOTH, METAL, LAMP, FLAME = range(7)


def refined(bound: Array, exact: Callable[[Array], Array], base: Array | None = None) -> Array:
    """``base``, by default ``bound``, replaced by ``exact`` of the indices where the lower bound is small."""
    result = np.array(bound if base is None else base)
    close = np.flatnonzero(bound < 0.3)
    if close.size:
        result[..., close] = exact(close)
    return result


def parts(u: Array, v: Array, y: Array) -> list[Array]:
    """Lower bounds of the distances to each kind of surface, positive in air; a point belongs to the nearest."""
    av = np.abs(v)
    s = np.abs(u - (EAST - BAY / 2 - BAY * bay_of(u)))
    rise = np.maximum(y - SPRING, 0)
    along = VAULT_RADIUS - length(av + (VAULT_RADIUS - HALF_WIDTH), rise)
    cross = CROSS_RADIUS - length(s + (CROSS_RADIUS - BAY / 2), rise)
    inner = HALF_WIDTH - av
    room = np.maximum(along, np.minimum(cross, inner))

    # Windows and niches are extra air behind the walls: look for them only close to a wall.
    def side_wall(k: Array) -> Array:
        s_, y_, d = s[k], y[k], inner[k]
        air = np.maximum(room[k], np.minimum(lancet(s_, y_, 1.36, 0.85, 4.15), d + 0.2))
        air = np.maximum(air, np.minimum(side_glass(s_, y_), d + DEPTH))
        niche = s_ - 0.375 - 0.75 * np.minimum(np.floor(s_ / 0.75), 1)
        return np.maximum(air, np.minimum(lancet(niche, y_, 0.27, -1.0, -0.15), d + 0.14))

    def east_wall(k: Array) -> Array:
        d = EAST - u[k]
        return np.maximum(d, np.minimum(east_glass(v[k], y[k]), d + DEPTH))

    def west_wall(k: Array) -> Array:
        v_, y_, d = v[k], y[k], u[k] - WEST
        air = np.maximum(d, np.minimum(2.7 - length(v_, y_ - ROSE_HEIGHT), d + 0.15))
        air = np.maximum(air, np.minimum(rose_glass(v_, y_), d + DEPTH))
        return np.maximum(air, np.minimum(lancet(v_, y_, 1.25, FLOOR - 1, 0.1), d + 0.3))

    shell = refined(inner, side_wall, room)
    shell = np.minimum(shell, refined(EAST - u, east_wall))
    shell = np.minimum(shell, refined(u - WEST, west_wall))
    step = np.maximum(EAST - 2.6 - u, y - FLOOR - 0.18)
    shell = np.minimum(np.minimum(shell, y - FLOOR), step)

    ribs = np.maximum(BAY / 2 - 0.15 - s, along - 0.24)
    ribs = np.minimum(ribs, 0.6 * np.maximum(np.abs(along - cross) - 0.17, np.maximum(along, cross) - 0.2))
    shaft = length(s - BAY / 2, inner - 0.16)
    ribs = np.minimum(ribs, np.maximum(shaft - 0.27, y - SPRING))
    rings = np.minimum(np.abs(y - SPRING + 0.12), np.abs(y - FLOOR - 0.12)) - 0.14  # capital and base
    ribs = np.minimum(ribs, np.maximum(shaft - 0.4, rings))
    ribs = np.minimum(ribs, np.maximum(np.abs(y - 0.66) - 0.06, inner - 0.1))  # string course

    def pews(k: Array) -> Array:
        u_, y_, a = u[k], y[k] - FLOOR, av[k] - 2.25
        row = u_ + 4.0 - np.clip(np.floor(u_ + 4.5), -4, 5)
        seat = box(row + 0.16, a, y_ - 0.42, (0.22, 1.15, 0.03))
        back = box(row - 0.1, a, y_ - 0.47, (0.03, 1.15, 0.47))
        end = box(row + 0.08, np.abs(a) - 1.15, y_ - 0.4, (0.26, 0.04, 0.45))
        return np.minimum(np.minimum(seat, back), end)

    def door(k: Array) -> Array:
        return np.maximum(-lancet(v[k], y[k], 1.25, FLOOR - 1, 0.1), u[k] - WEST + 0.26)

    def altar(k: Array) -> Array:
        u_, v_, y_, a = u[k], v[k], y[k], av[k]
        cloth = box(u_ - 6.2, v_, y_ - FLOOR - 0.6, (0.45, 1.3, 0.55))
        stick = length(u_ - 6.2, np.abs(np.abs(a - 0.7) - 0.3))  # candles at v = 0.4 and 1.0
        tall = 0.22 * np.floor(a / 0.7)
        metal = np.maximum(stick - 0.035, np.abs(y_ + 0.45) - 0.42 + tall)
        return np.stack([cloth, metal, np.sqrt(stick * stick + 0.25 * (y_ - 0.06 + tall) ** 2) - 0.036])

    def lamps(k: Array) -> Array:
        y_ = y[k]
        hang = length(s[k] - BAY / 2 + 0.3, av[k] - 2.2)
        cap = np.maximum(hang - 0.11, np.abs(y_ - 2.23) - 0.02)
        metal = np.minimum(np.maximum(hang - 0.012, 2.25 - y_), cap)
        return np.stack([metal, np.sqrt(hang**2 + 0.6 * (y_ - 2.1) ** 2) - LAMP_SIZE])

    wood = np.minimum(refined(y - FLOOR - 0.94, pews), refined(u - WEST + 0.26, door))
    at_altar, under_vault = np.maximum(5.75 - u, y - 0.25), 1.9 - y
    cloth, sticks, flame = refined(at_altar, altar, np.stack([at_altar] * 3))
    chains, lamp = refined(under_vault, lamps, np.stack([under_vault] * 2))
    return [shell, ribs, wood, cloth, np.minimum(chains, sticks), lamp, flame]


def distance(u: Array, v: Array, y: Array) -> Array:
    """A lower bound of the distance to the nearest surface."""
    return reduce(np.minimum, parts(u, v, y))


def march(origin: Array, ray: Array, start: Array | None = None, cone: float = 0.0) -> Array:
    """The distance that each ray travels before it meets a surface. ``origin`` and ``ray`` are (3, n).

    With a ``cone`` (its half angle), the distance for which the whole cone around the ray is certainly clear.
    """
    t = np.zeros(ray.shape[1]) if start is None else start.copy()
    alive = np.arange(ray.shape[1])
    o, d, at = origin, ray, t.copy()
    enough = 2e-4 + 0.3 * cone
    for step in range(110):
        gap = distance(*(o + at * d)) - cone * at
        at = at + np.maximum(gap, 0) if cone else at + gap
        if step % 3 == 2:
            t[alive] = at
            on = gap > enough * (1 + at)
            alive, o, d, at = alive[on], o[:, on], d[:, on], at[on]
            if alive.size == 0:
                break
    t[alive] = at
    return t


# --- colours --------------------------------------------------------------------------------------


def hash01(*keys: Array) -> Array:
    """A repeatable number in [0, 1) for a tuple of whole numbers (Wang's integer hash)."""
    h = np.full(keys[0].shape, 2166136261, np.uint32)
    for key in keys:
        h = h ^ key.astype(np.int64).astype(np.uint32)
        h = (h ^ np.uint32(61)) ^ (h >> np.uint32(16))
        h = h * np.uint32(9)
        h = h ^ (h >> np.uint32(4))
        h = h * np.uint32(0x27D4EB2D)
        h = h ^ (h >> np.uint32(15))
    return h / 4294967296.0


def pick(choice: Array, palette: Sequence[tuple[float, float, float]]) -> Array:
    """Colours (3, n) of a palette, for numbers in [0, 1)."""
    index = np.minimum((choice * len(palette)).astype(np.int64), len(palette) - 1)
    return np.array(palette)[index].T


GOLD = (1.0, 0.62, 0.16)
AMBER = (0.95, 0.42, 0.07)
RUBY = (0.85, 0.06, 0.04)
BLUE = (0.06, 0.16, 0.85)
SKY = (0.30, 0.58, 1.0)
TEAL = (0.08, 0.55, 0.60)
VIOLET = (0.38, 0.12, 0.75)
CLEAR = (1.0, 0.92, 0.75)


def leaded(s: Array, y: Array, inside: Array, pitch: float, palettes: Sequence[Sequence[tuple]]) -> Array:
    """Transmission (3, n) of a stained-glass light: border, medallions and a lattice of quarries."""
    border, medal, ground = palettes
    p, q = s / 0.26 + y / 0.36, s / 0.26 - y / 0.36
    i, j = np.floor(p), np.floor(q)
    colour = pick(hash01(i, j), ground)
    lead = np.maximum(np.abs(p - i - 0.5), np.abs(q - j - 0.5)) > 0.45

    k = np.floor(y / pitch)
    # A quatrefoil: four overlapping discs.
    r = length(np.abs(s) - 0.13, np.abs(y - (k + 0.5) * pitch) - 0.13)
    in_medal, in_ring = r < 0.17, (r >= 0.17) & (r < 0.26)
    colour = np.where(in_medal, pick(hash01(k, k * 0 + 7), medal), colour)
    colour = np.where(in_ring, pick(hash01(k, k * 0 + 3), border), colour)
    lead = np.where(r < 0.26, (np.abs(r - 0.17) < 0.015), lead | (np.abs(r - 0.26) < 0.015))

    step = np.floor(y / 0.3)
    in_border = inside < 0.12
    colour = np.where(in_border, pick(hash01(step, step * 0 + 11), border), colour)
    lead = np.where(in_border, np.abs(y / 0.3 - step - 0.5) > 0.45, lead) | (np.abs(inside - 0.12) < 0.02)
    return colour * np.where(lead, 0.04, 1.0)


def east_panes(v: Array, y: Array) -> Array:
    """Transmission (3, n) of the lancets."""
    local = np.where(np.abs(v) > 1.5, np.abs(v) - 2.5, v)
    palettes = ((RUBY, BLUE, RUBY, GOLD), (CLEAR, GOLD), (GOLD, AMBER, GOLD, CLEAR, AMBER, RUBY))
    return leaded(local, y, east_glass(v, y), 1.08, palettes)


def east_light(v: Array, y: Array, ray: Array | None = None) -> Array:
    """Radiance (3, n) of the lancets; including the sun and its glow if the viewing ``ray`` is given."""
    glass = east_panes(v, y)
    height = np.clip((y - 0.4) / 7.0, 0, 1)
    sky = np.array([[2.3], [1.5], [0.75]]) * (1.25 - 0.75 * height)
    light = glass * sky
    if ray is not None:
        off = 1 - (ray[0] * SUN[0] + ray[1] * SUN[1] + ray[2] * SUN[2])
        glow = 3.2 / (1 + off / 0.004) ** 2
        disc = 1 / (1 + (off / SUN_SPREAD) ** 2) ** 2
        light = light * (1 + glow) + (0.25 + 0.75 * glass) * disc * SUN_RADIANCE[:, None]
    return light


def side_light(s: Array, y: Array, right: Array, bay: Array) -> Array:
    """Radiance (3, n) of the side windows: clear dusk on the right, nearly night on the left."""
    local = np.where(y > 4.75, s, np.abs(s) - 0.64)
    inside = side_glass(s, y)
    cool = ((BLUE, SKY), (CLEAR, SKY, CLEAR), (SKY, BLUE, SKY, TEAL, SKY, SKY))
    dark = ((VIOLET, BLUE), (RUBY, SKY), (VIOLET, BLUE, TEAL, BLUE, RUBY))
    shifted = y + 0.37 * bay
    glass = np.where(
        right, leaded(local, shifted, inside, 0.96, cool), 0.33 * leaded(local, shifted, inside, 0.96, dark)
    )
    return glass * np.array([[1.15], [1.6], [2.3]]) * (0.75 + 0.08 * np.clip(y, 0, 6))


def rose_light(v: Array, y: Array) -> Array:
    """Radiance (3, n) of the rose window."""
    _, b = fold12(v, y - ROSE_HEIGHT)
    r = length(v, y - ROSE_HEIGHT)
    # Petals alternate in colour, by the number of the nearest of six axes.
    axes = [(math.cos(k * math.pi / 6), math.sin(k * math.pi / 6)) for k in range(6)]
    nearest = np.argmax(np.stack([np.abs(c * v + s * (y - ROSE_HEIGHT)) for c, s in axes]), axis=0)
    odd = nearest % 2 == 1
    petal = np.where(odd, np.array(RUBY)[:, None], np.array(BLUE)[:, None])
    petal = np.where(b < 0.07, np.array(GOLD)[:, None], petal)
    colour = np.where(r < 0.7, np.array(GOLD)[:, None], petal)
    colour = np.where(r > 1.93, np.where(odd, np.array(VIOLET)[:, None], np.array(RUBY)[:, None]), colour)
    inside = rose_glass(v, y)
    lead = (np.abs(b - 0.07) < 0.015) & (r > 0.7) | (np.abs(inside - 0.09) < 0.012)
    return colour * np.where(lead, 0.05, 1.0) * np.array([[1.0], [0.85], [1.15]])


# --- light ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Patch:
    """A small source of light: position, facing direction (zero: all directions), radiance times area."""

    at: Array
    facing: Array
    power: Array
    area: float


def irradiance(where: Array, normal: Array, patches: Sequence[Patch]) -> Array:
    """Irradiance (3, n) at points (3, n); a patch is a point light softened by its area."""
    total = np.zeros_like(where)
    for patch in patches:
        to = patch.at[:, None] - where
        square = to[0] * to[0] + to[1] * to[1] + to[2] * to[2]
        here = np.maximum(to[0] * normal[0] + to[1] * normal[1] + to[2] * normal[2], 0)
        if patch.facing.any():
            f = patch.facing
            there = np.maximum(-(to[0] * f[0] + to[1] * f[1] + to[2] * f[2]), 0)
            form = here * there / ((square + patch.area) * (square + 1e-9))
        else:
            form = here / ((square + patch.area) * np.sqrt(square + 1e-9))
        for channel in range(3):
            total[channel] += patch.power[channel] * form
    return total


def sunbeam(where: Array, normal: Array) -> Array:
    """Irradiance (3, n) from the sun through the lancets, blurred as if by the width of the sun's disc."""
    cosine = np.maximum(normal[0] * SUN[0] + normal[1] * SUN[1] + normal[2] * SUN[2], 0)
    far = np.maximum(EAST + DEPTH - where[0], 0) / SUN[0]
    v, y = where[1] + far * SUN[1], where[2] + far * SUN[2]
    blur = 0.03 + 0.009 * far
    edge = np.clip(0.5 + 0.5 * east_glass(v, y) / blur, 0, 1) * (far > 0.3)
    lit = np.flatnonzero((edge > 0) & (cosine > 0))
    result = np.zeros_like(where)
    if lit.size == 0:
        return result
    # The colours of the panes blend along the way: average a few places of the glass.
    colour = np.repeat(np.array([[0.40], [0.27], [0.12]]), lit.size, axis=1)
    for dv, dy in ((0.0, 0.0), (0.7, 0.3), (-0.7, -0.3), (0.3, -0.7), (-0.3, 0.7)):
        colour += 0.1 * east_panes(v[lit] + dv * blur[lit], y[lit] + dy * blur[lit])
    start = where[:, lit] + 0.03 * normal[:, lit]
    reach = march(start, np.repeat(SUN[:, None], lit.size, axis=1))
    clear = np.clip((reach - far[lit] + 0.8) / 0.4, 0, 1)
    result[:, lit] = colour * SUNBEAM[:, None] * (edge[lit] * cosine[lit] * clear)
    return result


def opening(
    centre: tuple[float, float],
    half: tuple[float, float],
    glass: Callable[[Array, Array], Array],
    light: Callable[[Array, Array], Array],
) -> Array:
    """Radiance times open area, on a grid of points over a window's rectangle around ``centre``."""
    n = 24
    grid = (np.arange(n) + 0.5) / n * 2 - 1
    s = centre[0] + half[0] * np.tile(grid, n)
    y = centre[1] + half[1] * np.repeat(grid, n)
    shown = np.where(glass(s, y) > 0, light(s, y), 0.0)
    return shown.mean(axis=1) * 4 * half[0] * half[1]


def sources() -> list[Patch]:
    """The windows, lamps and candles as patches."""
    patches = []
    for v, half, low, high, count in (
        (0, 0.95, 0.4, 6.6, 4),
        (-2.5, 0.8, 0.4, 5.2, 3),
        (2.5, 0.8, 0.4, 5.2, 3),
    ):
        tall = (high - low) / count / 2
        for k in range(count):
            y = low + (2 * k + 1) * tall
            power = opening((v, y), (half, tall), east_glass, east_light)
            # Towards the room, the sky around the sun is brighter than the open sky behind the glass.
            patches.append(Patch(np.array([EAST + 0.3, v, y]), np.array([-1.0, 0, 0]), 1.5 * power, 1.0))
    for bay in range(BAYS):
        u = EAST - BAY / 2 - BAY * bay
        for side in (1.0, -1.0):

            def light(s: Array, y: Array, side: float = side, bay: int = bay) -> Array:
                return side_light(s, y, np.full(s.shape, side > 0), np.full(s.shape, float(bay)))

            for y in (1.85, 3.55, 5.2):
                power = opening((0, y), (1.25, 0.85), side_glass, light)
                at = np.array([u, side * (HALF_WIDTH + 0.3), y])
                patches.append(Patch(at, np.array([0, -side, 0]), power, 1.0))
    for v in (-1.2, 1.2):
        for dy in (-1.2, 1.2):
            power = opening((v, ROSE_HEIGHT + dy), (1.3, 1.3), rose_glass, rose_light)
            at = np.array([WEST - 0.3, v, ROSE_HEIGHT + dy])
            patches.append(Patch(at, np.array([1.0, 0, 0]), power, 1.0))
    nowhere = np.zeros(3)
    for bay in range(BAYS):
        for edge in (0.3, BAY - 0.3):
            for v in (-2.2, 2.2):
                at = np.array([EAST - BAY * bay - edge, v, 2.1])
                patches.append(Patch(at, nowhere, LAMP_RADIANCE * 0.02, 0.05))
    for v in (-1.0, -0.4, 0.4, 1.0):
        patches.append(Patch(np.array([6.2, v, 0.0]), nowhere, FLAME_RADIANCE * 0.006, 0.05))
    return patches


def bounced(direct: Sequence[Patch]) -> list[Patch]:
    """Patches of floor, walls and vault that reflect the light of ``direct``, up to two bounces."""
    places: list[tuple[Array, Array, Array, float]] = []
    dark = np.array([0.16, 0.15, 0.14])
    for k in range(2 * BAYS):
        u = EAST - BAY / 4 - k * BAY / 2
        for v in (-2.25, 2.25):
            area = HALF_WIDTH * BAY / 2
            places.append((np.array([u, v, FLOOR]), np.array([0, 0, 1.0]), dark, area))
            if k % 2:
                slope = np.array([0, -v, -2.25]) / math.sqrt(2 * 2.25**2)
                vault = np.array([0.12, 0.12, 0.14])
                places.append((np.array([u + BAY / 4, 1.1 * v, 6.6]), slope, vault, 3 * area))
            wall = np.array([u, math.copysign(HALF_WIDTH, v), 0.2])
            places.append((wall, np.array([0, -math.copysign(1, v), 0]), STONE, 6.0))
    for u, facing in ((EAST, -1.0), (WEST, 1.0)):
        for v in (-2.25, 2.25):
            for y in (0.0, 4.5):
                places.append((np.array([u, v, y]), np.array([facing, 0, 0]), STONE, 12.0))
    where = np.array([place[0] for place in places]).T
    normal = np.array([place[1] for place in places]).T
    lifted = where + 0.05 * normal
    first = irradiance(lifted, normal, direct)
    floor = normal[2] > 0.5
    # The beam covers about a third of the floor between two and ten metres from the lancets.
    in_beam = floor & (where[0] < 4) & (where[0] > -9) & (where[1] < 0)
    first = first + np.where(in_beam, 0.25 * SUN[2], 0.0) * SUNBEAM[:, None]
    result: list[Patch] = []
    light = first
    for _ in range(2):
        result = [
            Patch(where[:, i], normal[:, i], place[2] * light[:, i] / math.pi * place[3], place[3] / 2)
            for i, place in enumerate(places)
        ]
        light = first + irradiance(lifted, normal, result)
    return result


# --- the picture ----------------------------------------------------------------------------------


def normals(where: Array) -> Array:
    """Unit normals (3, n) of surface points, from four evaluations of the distance."""
    total = np.zeros_like(where)
    for corner in ((1, -1, -1), (-1, -1, 1), (-1, 1, -1), (1, 1, 1)):
        step = np.array(corner, np.float64)[:, None]
        total = total + step * distance(*(where + 0.003 * step))
    size = np.sqrt(total[0] ** 2 + total[1] ** 2 + total[2] ** 2)
    return total / np.maximum(size, 1e-12)


def openness(where: Array, normal: Array) -> Array:
    """How open the hemisphere above a surface is: from 0 (a crevice) to 1 (nothing nearby)."""
    result = np.ones(where.shape[1])
    for reach, weight in ((0.12, 0.4), (0.35, 0.45), (0.9, 0.55)):
        free = np.clip(distance(*(where + reach * normal)) / reach, 0, 1)
        result = result * (1 - weight * (1 - free))
    return result


def stone(where: Array, normal: Array) -> Array:
    """Albedo (3, n) of coursed ashlar."""
    along = np.where(np.abs(normal[0]) > np.abs(normal[1]), where[1], where[0])
    course = np.floor((where[2] - FLOOR) / 0.45)
    x = along / 0.95 + 0.5 * (course - 2 * np.floor(course / 2)) + 0.13 * hash01(course, course * 0)
    block = np.floor(x)
    tint = 0.86 + 0.28 * hash01(course, block, block * 0 + 5)
    joint = (np.abs(x - block - 0.5) > 0.484) | (np.abs((where[2] - FLOOR) / 0.45 - course - 0.5) > 0.47)
    return STONE[:, None] * (tint * np.where(joint, 0.62, 1.0))


def tiles(where: Array) -> Array:
    """Albedo (3, n) of the floor: diagonal chequers between pale bands."""
    p, q = (where[0] + where[1]) / 0.72 + 0.5, (where[0] - where[1]) / 0.72 + 0.5
    i, j = np.floor(p), np.floor(q)
    even = (i + j) - 2 * np.floor((i + j) / 2) < 0.5
    tint = 0.85 + 0.3 * hash01(i, j)
    pale, deep = np.array([[0.30], [0.29], [0.26]]), np.array([[0.055], [0.05], [0.055]])
    colour = np.where(even, pale, deep) * tint
    band = np.abs(np.abs(where[1]) - 0.98) < 0.07
    colour = np.where(band, np.array([[0.25], [0.10], [0.06]]), colour)
    joint = np.maximum(np.abs(p - i - 0.5), np.abs(q - j - 0.5)) > 0.48
    return colour * np.where(joint, 0.6, 1.0)


def webs(where: Array) -> Array:
    """Albedo (3, n) of the vault between its ribs: night blue with gold stars."""
    a, b = where[0] / 0.5, where[1] / 0.5
    i = np.floor(a)
    b = b + 0.5 * (i - 2 * np.floor(i / 2))
    j = np.floor(b)
    x, y = np.abs(a - i - 0.5), np.abs(b - j - 0.5)
    star = np.sqrt(x) + np.sqrt(y) < 0.52  # an astroid has four points
    return np.where(star, np.array([[0.75], [0.50], [0.14]]), np.array([[0.045], [0.075], [0.20]]))


def radiance(
    patches: Sequence[Patch], origin: Array, ray: Array, start: Array | None = None, bounces: int = 1
) -> Array:
    """Radiance (3, n) that arrives at ``origin`` (3, n) from along ``ray`` (3, n), in (u, v, y), lit by ``patches``.

    The first ``start`` (n,) metres of the rays are known to be clear.
    """
    where = origin + march(origin, ray, start) * ray
    u, v, y = where
    kind = np.argmin(parts(u, v, y), axis=0)
    result = np.zeros_like(where)

    bay = bay_of(u)
    s = u - (EAST - BAY / 2 - BAY * bay)
    at_side = (kind == SHELL) & (np.abs(v) > HALF_WIDTH + DEPTH - 0.05) & (side_glass(s, y) > 0.01)
    at_east = (kind == SHELL) & (u > EAST + DEPTH - 0.05) & (east_glass(v, y) > 0.01)
    at_rose = (kind == SHELL) & (u < WEST - DEPTH + 0.05) & (rose_glass(v, y) > 0.01)
    for chosen, light in (
        (at_side, lambda m: side_light(s[m], y[m], v[m] > 0, bay[m])),
        (at_east, lambda m: east_light(v[m], y[m], ray[:, m])),
        (at_rose, lambda m: rose_light(v[m], y[m])),
        (kind == LAMP, lambda m: LAMP_RADIANCE[:, None] * np.ones(np.count_nonzero(m))),
        (kind == FLAME, lambda m: FLAME_RADIANCE[:, None] * np.ones(np.count_nonzero(m))),
    ):
        if chosen.any():
            result[:, chosen] = light(chosen)

    solid = np.flatnonzero(~(at_side | at_east | at_rose | (kind >= LAMP)))
    if solid.size == 0:
        return result
    p, kind, seen = where[:, solid], kind[solid], ray[:, solid]
    normal = normals(p)
    albedo = stone(p, normal)
    on_floor = (kind == SHELL) & (normal[2] > 0.9) & (p[2] < FLOOR + 0.3)
    on_web = (kind == SHELL) & (p[2] > SPRING) & (normal[2] < -0.02)
    albedo = np.where(on_floor, tiles(p), albedo)
    albedo = np.where(on_web, webs(p), albedo)
    rib = STONE[:, None] * np.where(p[2] > SPRING, 1.25, 1.05)
    albedo = np.where(kind == RIBS, rib, albedo)
    albedo = np.where(kind == WOOD, np.array([[0.105], [0.058], [0.030]]), albedo)
    albedo = np.where(kind == CLOTH, np.array([[0.42], [0.40], [0.36]]), albedo)
    albedo = np.where(kind == METAL, np.array([[0.22], [0.14], [0.05]]), albedo)
    lifted = p + 0.02 * normal
    light = irradiance(lifted, normal, patches) * openness(p, normal) + sunbeam(p, normal)
    shade = albedo * (light + 0.003) / math.pi

    if bounces > 0 and on_floor.any():
        m = np.flatnonzero(on_floor)
        n, d = normal[:, m], seen[:, m]
        cosine = np.clip(-(n[0] * d[0] + n[1] * d[1] + n[2] * d[2]), 0, 1)
        x = 1 - cosine
        fresnel = 0.035 + 0.5 * x * x * x * x * x
        mirror = d + 2 * cosine * n
        shade[:, m] += fresnel * np.minimum(radiance(patches, lifted[:, m], mirror, bounces=bounces - 1), 30.0)
    result[:, solid] = shade
    return result


def rays(rows: Array, columns: Array) -> Array:
    """Unit directions (3, rows x columns) in (u, v, y) through fractional rows and columns of the map.

    The sines are rounded to 2^-40 so that every mathematics library gives the same result.
    """

    def circle(angles: Array) -> tuple[Array, Array]:
        sine = np.array([math.sin(angle) for angle in angles])
        cosine = np.array([math.cos(angle) for angle in angles])
        return np.round(sine * 2.0**40) / 2.0**40, np.round(cosine * 2.0**40) / 2.0**40

    sin_theta, cos_theta = circle(math.pi * rows / HEIGHT)
    sin_phi, cos_phi = circle(2 * math.pi * columns / WIDTH)
    x, z = np.outer(sin_theta, cos_phi).ravel(), np.outer(sin_theta, sin_phi).ravel()
    return np.stack([(z - x) * math.sqrt(0.5), (x + z) * math.sqrt(0.5), np.repeat(cos_theta, columns.size)])


def render_rows(rows: Sequence[int]) -> NDArray[np.float16]:
    """Rows of the map, (len(rows), WIDTH, 3): the mean of ``SUPERSAMPLES`` squared rays per pixel."""
    direct = sources()
    patches = direct + bounced(direct)
    n = SUPERSAMPLES
    result = np.empty((len(rows), WIDTH, 3), np.float16)
    sub = (np.arange(n) + 0.5) / n
    columns = (np.arange(WIDTH)[:, None] + sub).ravel()
    for i, row in enumerate(rows):
        # A single cone around a pixel finds how far all of its rays are clear.
        middle = rays(np.array([row + 0.5]), np.arange(WIDTH) + 0.5)
        clear = march(np.zeros_like(middle), middle, cone=1.06 * math.pi / HEIGHT / math.sqrt(2))
        ray = rays(row + sub, columns)
        light = radiance(patches, np.zeros_like(ray), ray, np.tile(np.repeat(clear, n), n))
        light = light.reshape(3, n, WIDTH, n)
        total = sum(light[:, j, :, k] for j in range(n) for k in range(n))
        result[i] = (total / n**2).T
    # Eight bits of fraction are accurate to 0.2 % and compress much better than the ten of a half float.
    bits = result.view(np.uint16)
    bits[...] = (bits + np.uint16(2)) & np.uint16(0xFFFC)
    return result


def render() -> NDArray[np.float16]:
    """The whole map, (HEIGHT, WIDTH, 3), on all cores."""
    bands = [range(top, min(top + 8, HEIGHT)) for top in range(0, HEIGHT, 8)]
    with ProcessPoolExecutor() as pool:
        with Unheard():  # Ctrl-C goes to the whole process group, but only this process must handle it
            rendered = pool.map(render_rows, bands)
        return np.concatenate(list(rendered))


def write(path: Path, pixels: NDArray[np.float16]) -> None:
    """Write (height, width, 3) as a half-float EXR file with ZIP compression."""
    import OpenImageIO as oiio  # imported here, so that the ray tracer alone needs only numpy

    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], 3, "half")
    spec.attribute("compression", "zip:9")
    spec.attribute("DateTime", "")  # otherwise the file would change with every run
    name = utf8_name(path)
    output = oiio.ImageOutput.create(name)
    written = output.open(name, spec) and output.write_image(pixels)
    if not (output.close() and written):
        raise LightdomeError(f"cannot write {path}: {output.geterror() or 'the writer failed'}")


def main() -> None:
    parser = argparse.ArgumentParser(
        description="Make the default environment map: a vaulted chapel at dusk, ray traced with numpy.",
        epilog="example: scripts/make_default_map.py --out chapel.exr",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    default = Path(__file__).resolve().parent.parent / "data" / "default.exr"
    parser.add_argument("--out", type=Path, default=default, metavar="FILE", help="the .exr file to write")
    out: Path = parser.parse_args().out
    if out.suffix.lower() != ".exr":
        parser.error(f"argument --out: {out} does not end in .exr")
    utf8_name(out)
    began = time.perf_counter()
    with replacing(out) as temporary:  # refuses an unwritable path before the work, not after it
        pixels = render()
        write(temporary, pixels)
    luminance = pixels.astype(np.float64).mean(axis=2)
    print(
        f"wrote {out}: {WIDTH} x {HEIGHT}, luminance {luminance.min():.2g} to {luminance.max():.0f}, "
        f"median {np.median(luminance):.2g}, {out.stat().st_size / 1e6:.2f} MB, "
        f"{time.perf_counter() - began:.0f} s"
    )


if __name__ == "__main__":
    run(main)
