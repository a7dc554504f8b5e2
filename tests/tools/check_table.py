"""How often ``lightdome check`` names a mistake, and how often it raises a false alarm.

    .venv/bin/python tests/tools/check_table.py [image] [--mistakes NAME...] [--maps N] [--right N]
    .venv/bin/python tests/tools/check_table.py samples|pdf|lights|fresnel

Images: first, N correct images are checked, made with lightdome's sequences and estimators and with numpy's random
numbers. Then each mistake in ``tests/student.py`` is made on ten maps, with ten seeds and sample counts. If the
converged image of a mistake differs from the correct one by less than the samples' noise, "agrees" is the right
verdict; such images are counted separately.

The other kinds: each mistake that the tests know is made on the same ten maps, or for several refractive indices. A
mistake that does not change the result agrees; the row "none" holds correct results.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "checking"))

from helpers import GRACE, ROOT
from lightdome.checking.fresnel import CAUSES_OF_CURVES, check_fresnel
from lightdome.checking.image import ImageCheck, Reference
from lightdome.checking.lights import check_lights
from lightdome.checking.pdf import check_pdf
from lightdome.checking.samples import check_samples
from lightdome.checking.tables import TableCheck
from lightdome.disc import disc_mask
from lightdome.evaluation.metrics import relative_rmse
from lightdome.lighting.exact import exact
from lightdome.lighting.shade import shade_samples
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.geometry import column_angles, directions, row_angles, solid_angles
from lightdome.names import ESTIMATORS, SEQUENCES
from lightdome.opencl.device import Device, open_device
from lightdome.rendering.per_pixel import render as render_per_pixel
from lightdome.sampling.distribution import build_distribution
from student import ALBEDO, MISTAKES, render
from student_fresnel import curves
from student_lights import cut
from student_samples import draw
from test_check_fresnel import DEGREES, OF_BOTH, sides
from test_check_lights import MISTAKES as MISTAKES_OF_LIGHTS
from test_check_lights import TURNED
from test_check_pdf import images
from test_check_samples import MISTAKES as MISTAKES_OF_SAMPLES
from test_check_samples import points

CONVERGED = 2**19  # samples


def reduced(radiance: np.ndarray, height: int, width: int) -> np.ndarray:
    """Means over blocks of pixels, weighted by solid angle."""
    rows, columns = len(radiance) // height, radiance.shape[1] // width
    weight = solid_angles(*radiance.shape[:2])[:, None, None]
    blocks = (radiance * weight).reshape(height, rows, width, columns, 3).sum(axis=(1, 3))
    areas = np.broadcast_to(weight, (*radiance.shape[:2], 1)).reshape(height, rows, width, columns, 1).sum(axis=(1, 3))
    return (blocks / areas).astype(np.float32)


def lamps(height: int, width: int, *lamp: tuple[float, float, float, tuple[float, float, float]]) -> np.ndarray:
    """A grey sky with lamps, each with its azimuth, elevation and radius in degrees, and its radiance."""
    towards = directions(row_angles(height)[:, None], column_angles(width)[None])
    radiance = np.full((height, width, 3), 0.1)
    for azimuth, elevation, radius, colour in lamp:
        middle = directions(np.radians(90 - elevation), np.radians(azimuth))
        radiance[towards @ middle > np.cos(np.radians(radius))] = colour
    return radiance.astype(np.float32)


def maps() -> dict[str, np.ndarray]:
    """Ten maps, five of them 64 x 32 pixels and five 128 x 64."""
    whole = EnvironmentMap.read(ROOT / "data" / "default.exr").radiance
    made = {f"default {w} x {w // 2}": reduced(whole, w // 2, w) for w in (64, 128)}
    if GRACE.exists():
        grace = EnvironmentMap.read(GRACE).radiance
        made |= {f"Grace {w} x {w // 2}": reduced(grace, w // 2, w) for w in (64, 128)}
    y, x = np.mgrid[0:64, 0:128]
    gradient = np.stack(
        [0.5 + 0.4 * np.cos(np.pi * y / 64 + c) + 0.2 * np.cos(np.pi * x / 64 + c) for c in range(3)], 2
    )
    rng = np.random.default_rng(5)
    return made | {
        "sun 64 x 32": lamps(32, 64, (60, 40, 5, (900, 800, 600))),
        "sun 128 x 64": lamps(64, 128, (130, 25, 3, (2000, 1900, 1500))),
        "lamps 64 x 32": lamps(32, 64, (20, 50, 8, (9, 4, 1)), (100, -20, 6, (2, 5, 9)), (200, 70, 9, (3, 8, 2))),
        "lamps 128 x 64": lamps(64, 128, (80, 10, 5, (30, 9, 3)), (150, 60, 4, (9, 9, 30)), (30, -50, 7, (2, 9, 4))),
        "overcast 128 x 64": np.maximum(gradient, 0.02).astype(np.float32),
        "noise 64 x 32": np.exp(rng.normal(0, 1.5, (32, 64, 3))).astype(np.float32),
    }


def said(check: ImageCheck) -> str:
    """The verdict as the table shows it."""
    if check.agrees is not False:
        return "agrees" if check.agrees else "cannot tell"
    if "; either " in check.verdict:
        return "one of several"
    return check.verdict.removeprefix("does not agree; ").partition(":")[0]


def tell_mistakes(device: Device, names: list[str], side: int, most: int) -> bool:
    """Print a row per mistake: how often it was named, of how many images that show it, and other verdicts."""
    envmaps = {name: EnvironmentMap(radiance) for name, radiance in list(maps().items())[:most]}
    references: dict[tuple[str, float], Reference] = {}
    good = True
    print("| mistake | named | of | does not show | said instead |\n| --- | --- | --- | --- | --- |")
    for mistake in names:
        named = shown = hidden = 0
        others: Counter[str] = Counter()
        for seed, (name, envmap) in enumerate(envmaps.items()):
            albedo, count = ALBEDO.get(mistake, 1.0), (65536, 16384, 4096)[seed % 3]
            if (name, albedo) not in references:
                references[name, albedo] = Reference(device, envmap, albedo)
            check = references[name, albedo].check(
                render(envmap.radiance, count, side, seed, mistake, albedo), count=count
            )
            truth = exact(device, envmap, side, albedo)[disc_mask(side)]
            limit = render(envmap.radiance, CONVERGED, side, seed, mistake, albedo)[disc_mask(side)]
            assert check.expected
            if check.agrees and relative_rmse(limit, truth) < check.expected.high + 3e-3:
                hidden += 1
                continue
            shown += 1
            if MISTAKES[mistake] in check.verdict and "; either " not in check.verdict:
                named += 1
            else:
                others[f"{said(check)} ({name})"] += 1
        instead = "; ".join(f"{n} x {text}" if n > 1 else text for text, n in others.items())
        good = good and named >= 0.9 * shown
        print(f"| {mistake} | {named} | {shown} | {hidden} | {instead} |", flush=True)
    return good


def tell_false_alarms(device: Device, count: int) -> bool:
    """Print how many of ``count`` correct images agree."""
    made = maps()
    envmaps = {name: EnvironmentMap(made[name]) for name in ("default 128 x 64", "sun 64 x 32", "lamps 128 x 64")}
    references = {name: Reference(device, envmap) for name, envmap in envmaps.items()}
    verdicts: Counter[str] = Counter()
    sides, counts = (31, 63, 101, 127, 255, 511), (16, 64, 256, 1024, 4096)
    methods = [*SEQUENCES, "numpy", *ESTIMATORS]
    for i in range(count):
        rng = np.random.default_rng(i)
        method, name = methods[i % len(methods)], list(envmaps)[i // len(methods) % 3]
        side = int(rng.choice(sides if i % 8 == 0 else sides[:4]))
        envmap = envmaps[name]
        if method in ESTIMATORS:
            n, per_pixel = int(2 ** rng.integers(0, 7)), True
            distribution = build_distribution(device, envmap)
            ((_, image),) = render_per_pixel(distribution, [n], side, seed=i, estimator=method)
        else:
            n, per_pixel = int(rng.choice(counts)), False
            if method == "numpy":
                image = render(envmap.radiance, n, side, i)
            else:
                within = ("centre", "pixel")[int(rng.integers(2))]
                samples = build_distribution(device, envmap).sample(n, seed=i, sequence=method, within=within)
                image = shade_samples(device, samples, side)
        check = references[name].check(image, count=n, per_pixel=per_pixel)
        verdicts[said(check) if check.agrees is not False else "false alarm"] += 1
        if not check.agrees:
            print(f"  {method}, {n} samples, {side} pixels, {name}: {check.verdict}", flush=True)
    print(", ".join(f"{n} {text}" for text, n in verdicts.items()))
    return not verdicts["false alarm"]


def checks_of(kind: str, device: Device) -> Iterator[tuple[str, str, TableCheck]]:
    """The mistake, where it is made, and what the check found; the mistake is "" where there is none."""
    if kind == "fresnel":
        for mistake in ("", *(cause.name for cause in CAUSES_OF_CURVES)):
            for eta in (1.1, 1.33, 1.4, 1.5, 2.4):
                for leaving in sides(mistake):
                    found = curves(DEGREES, eta, leaving, mistake)
                    names = list(found) if mistake in OF_BOTH else ["p", "s"] if "p" in found else ["reflectance"]
                    values = {name: found[name] for name in names}
                    check = check_fresnel(np.radians(DEGREES), **values, eta=eta, leaving=leaving)
                    yield mistake, f"{eta}{', leaving' * leaving}", check
        return
    made = {name: EnvironmentMap(radiance) for name, radiance in maps().items()}
    mistakes = {"samples": MISTAKES_OF_SAMPLES, "lights": [*MISTAKES_OF_LIGHTS, *TURNED], "pdf": []}[kind]
    for seed, (name, envmap) in enumerate(made.items()):
        if kind == "pdf":
            for mistake, image in images(envmap.radiance).items():
                yield mistake, name, check_pdf(envmap, image)
        for mistake in ("", *mistakes) if mistakes else ():
            if kind == "samples":
                radiance = envmap.radiance.copy()
                if mistake == "zero-weight pixels drawn":
                    radiance[:2] = 0
                samples = draw(radiance, points(4096, seed), mistake, within=seed % 2 == 1)
                yield mistake, name, check_samples(EnvironmentMap(radiance), **samples)
            else:
                yield (
                    mistake,
                    name,
                    check_lights(device, envmap, *cut(envmap.radiance, (16, 64, 256)[seed % 3], mistake)),
                )


def tell_kind(kind: str, device: Device) -> bool:
    """Print a row for each mistake of another kind than images: named, of how many, and what was said instead."""
    rows: dict[str, Counter[str]] = {}
    for mistake, where, check in checks_of(kind, device):
        words = "agrees" if check.agrees else check.verdict.removeprefix("does not agree; ").partition(":")[0]
        right = check.verdict.startswith("agrees") if not mistake else mistake in check.verdict
        rows.setdefault(mistake, Counter())[
            "right" if right else words if words == "agrees" else f"{words} ({where})"
        ] += 1
    print("| mistake | named | of | agrees | said instead |\n| --- | --- | --- | --- | --- |")
    good = True
    for mistake, said_of in rows.items():
        right, agrees = said_of.pop("right", 0), said_of.pop("agrees", 0)
        shown = right + sum(said_of.values())
        good = good and right >= 0.9 * shown
        print(f"| {mistake or 'none'} | {right} | {shown} | {agrees} | {'; '.join(said_of)} |")
    return good


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    kinds = ("image", "samples", "pdf", "lights", "fresnel")
    parser.add_argument("kind", nargs="?", default="image", choices=kinds, help="image is the default")
    parser.add_argument("--mistakes", nargs="*", default=list(MISTAKES), choices=MISTAKES, metavar="NAME")
    parser.add_argument("--right", type=int, default=200, metavar="N", help="number of images without a mistake")
    parser.add_argument("--side", type=int, default=63, help="width and height in pixels of an image with a mistake")
    parser.add_argument("--maps", type=int, default=10, metavar="N", help="number of maps on which each is made")
    args = parser.parse_args()
    device = open_device()
    began = time.monotonic()
    if args.kind == "image":
        good = tell_false_alarms(device, args.right)
        good = tell_mistakes(device, args.mistakes, args.side, args.maps) and good
    else:
        good = tell_kind(args.kind, device)
    print(f"{time.monotonic() - began:.0f} s")
    sys.exit(not good)


if __name__ == "__main__":
    main()
