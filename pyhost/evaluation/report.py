"""The written report, typeset with Typst from the commands' results, and an archive of all images.

:func:`write` draws the figures, gathers the numbers, fills ``report.typ`` with them, and packs the report with the
images. The same inputs give the same bytes: no file records when it was made. The caller makes sure that the results
belong together, see :mod:`lightdome.commands.settings`.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import tempfile
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .. import plotting  # first: it imports matplotlib

# isort: split
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from ..disc import disc_mask
from ..errors import LightdomeError
from ..files import replacing, write_json
from ..lighting.exact import exact_kept
from ..maps.envmap import EnvironmentMap
from ..maps.images import read_image, tone_map, write_image
from ..maps.sphere import sphere_exposure
from ..opencl.device import Device
from ..progress import Progress
from ..sampling.distribution import build_distribution
from ..sampling.samples import Samples
from . import benchmark_plot, report_figures, stability, stability_plot
from .benchmark import MethodMeasurement
from .metrics import LEVELS, cheapest, left_after_averaging

PDF, ARCHIVE, SUMS = "report.pdf", "lightdome-report.zip", "SHA256SUMS"
TEMPLATE = ("report.typ", "report.bib")
MISSING = "the report is typeset with Typst, which is not installed; pip install 'lightdome[report]'"
AVERAGED = 16  # pixels; side of the squares that the text mentions


@dataclass(frozen=True)
class Results:
    """Folders that the commands wrote, all for one map and one version, with their settings under the same names.

    The names are ``part1`` to ``part4``, ``bench`` and ``stability``; the settings of the last two are ``bench.json``
    and ``stability.json``.
    """

    folders: Mapping[str, Path]
    settings: Mapping[str, Mapping[str, Any]]


def require_typst() -> None:
    """Raise :class:`LightdomeError` if the extra ``[report]`` is not installed."""
    try:
        import typst  # noqa: F401
    except ImportError as error:
        raise LightdomeError(MISSING) from error


@dataclass(frozen=True)
class Images:
    """The sphere's images, (R, R, 3) radiance each: with samples that all pixels share, with samples per pixel, exact.

    ``exact_per_pixel`` is what samples per pixel converge to; PBRT treats a map's pixels as areas.
    """

    shared: Mapping[int, np.ndarray]
    per_pixel: Mapping[int, np.ndarray]
    exact: np.ndarray
    exact_per_pixel: np.ndarray

    def named(self) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        """The shared and the per-pixel images under their names in figures and tables."""
        return (
            {f"{n} shared": image for n, image in self.shared.items()},
            {f"{n} per pixel": image for n, image in self.per_pixel.items()},
        )

    def alike(self) -> tuple[tuple[str, np.ndarray], tuple[str, np.ndarray]]:
        """The shared and the per-pixel image with the most similar errors, and their names."""
        shared, per_pixel = self.named()

        def distance(pair: tuple[tuple[str, np.ndarray], tuple[str, np.ndarray]]) -> float:
            exact = (self.exact, self.exact_per_pixel)
            a, b = (left_after_averaging(image, own, 1) for (_, image), own in zip(pair, exact, strict=True))
            return max(a, b) / max(min(a, b), 1e-9)

        return min(((a, b) for a in shared.items() for b in per_pixel.items()), key=distance)


def load_images(device: Device, envmap: EnvironmentMap, results: Results) -> Images:
    """The images of parts 3 and 4, and the exact images.

    Raises :class:`LightdomeError` if one cannot be read, or is black.
    """
    counts, spp = _options(results, "part2", "counts"), _options(results, "part4", "spp")
    resolution = _options(results, "part3", "resolution")
    exact = exact_kept(device, envmap, resolution)
    if not exact.any():
        raise LightdomeError("no light of this map falls on the visible side of the sphere; use another map")
    return Images(
        {n: read_image(results.folders["part3"] / f"sphere_{n}.pfm") for n in sorted(counts)},
        {n: read_image(results.folders["part4"] / f"sphere_{n}spp.pfm") for n in sorted(spp)},
        exact,
        exact_kept(device, envmap, resolution, "areas") if results.settings["part4"]["pbrt"] else exact,
    )


def _options(results: Results, name: str, option: str) -> Any:
    return results.settings[name]["options"][option]


def write(
    device: Device,
    envmap: EnvironmentMap,
    map_name: str,
    results: Results,
    out: Path,
    _draw: Callable[[Device, EnvironmentMap, Results, Images, Path], None] | None = None,
) -> int:
    """Write ``report.pdf``, the exact image and ``lightdome-report.zip`` into ``out``; returns the number of images.

    Raises :class:`LightdomeError` if a file cannot be read or written, if no light falls on the sphere, or if Typst is
    not installed.
    """
    require_typst()
    images = load_images(device, envmap, results)
    picture = tone_map(images.exact, sphere_exposure(envmap))
    packed = {
        f"{name}/{file}": results.folders[name] / file
        for name in ("part2", "part3", "part4")
        for file in results.settings[name]["files"]
        if file.endswith((".pfm", ".ppm"))
    }
    for suffix, pixels in (("pfm", images.exact), ("ppm", picture)):
        packed[f"exact/sphere.{suffix}"] = out / f"exact.{suffix}"
        write_image(out / f"exact.{suffix}", pixels)

    with tempfile.TemporaryDirectory(prefix="lightdome-") as name:
        folder = Path(name)
        (_draw or draw)(device, envmap, results, images, folder)
        write_json(folder / "data.json", numbers(envmap, map_name, results, images))
        for file in TEMPLATE:
            shutil.copy(Path(__file__).with_name(file), folder)
        pdf = _typeset(folder)
    with replacing(out / PDF) as temporary:
        temporary.write_bytes(pdf)
    _pack(out / ARCHIVE, {PDF: out / PDF, **packed})
    return len(packed)


def draw(device: Device, envmap: EnvironmentMap, results: Results, images: Images, folder: Path) -> None:
    """Write all figures into ``folder``, under the names that ``report.typ`` uses."""
    shared, per_pixel = images.named()
    exposure = sphere_exposure(envmap)
    points = _points(results)
    figures: dict[str, Callable[[], Figure]] = {
        "cdfs": lambda: report_figures.cdfs(build_distribution(device, envmap)),
        "shared": lambda: benchmark_plot.images(shared, images.exact, "", exposure=exposure),
        "per_pixel": lambda: benchmark_plot.images(per_pixel, images.exact_per_pixel, "", exposure=exposure),
        "bias_and_noise": lambda: report_figures.bias_and_noise(*images.alike(), images.exact, images.exact_per_pixel),
        "averaging": lambda: report_figures.averaging(shared, per_pixel, images.exact, images.exact_per_pixel),
        "error_time": lambda: benchmark_plot.error_against_time(points, ""),
        "error_time_all": lambda: benchmark_plot.error_against_time_all(points, ""),
        "error_count": lambda: benchmark_plot.error_against_count(points, ""),
    }
    with Progress("figures") as progress:
        for done, (stem, draw) in enumerate(figures.items()):
            plotting.save_figure(draw(), folder / f"{stem}.svg", report_figures.DPI)
            progress.update((done + 1) / len(figures))
    ready = {
        "part1": [f"{what}_{way}.svg" for what in ("fresnel", "schlick") for way in ("entering", "leaving")],
        "part2": [f"em_{n}.png" for n in images.shared],
    }
    for name, files in ready.items():
        for file in files:
            shutil.copy(results.folders[name] / file, folder)


def numbers(envmap: EnvironmentMap, map_name: str, results: Results, images: Images) -> dict[str, object]:
    """All that ``report.typ`` prints, in JSON types only: numbers as text, rounded for display, and table rows."""
    version, made_of = (results.settings["part2"][key] for key in ("versions", "map"))
    points = _points(results)
    samples = [Samples.load(results.folders["part2"] / f"samples_{n}.npz") for n in images.shared]
    return {
        "version": version["lightdome"],
        "map": {"name": map_name, **made_of, **_range(envmap)},
        "fresnel": _fresnel(results.folders["part1"]),
        "sequence": _options(results, "part2", "sequence"),
        "seed": str(_options(results, "part2", "seed")),
        "resolution": len(images.exact),
        "pixels": f"{int(disc_mask(len(images.exact)).sum()):,}",
        "counts": list(images.shared),
        "spp": list(images.per_pixel),
        "renderer": results.settings["part4"]["pbrt"],
        "drawn": [_drawn(s) for s in samples],
        "shared": [[str(n), *_errors(image, images.exact)] for n, image in images.shared.items()],
        "per_pixel": [[str(n), *_errors(image, images.exact_per_pixel)] for n, image in images.per_pixel.items()],
        "pair": [name for name, _ in images.alike()],
        "averaged": AVERAGED,
        "averaging": [
            [name, *_averaged(image, exact)]
            for of_kind, exact in zip(images.named(), (images.exact, images.exact_per_pixel), strict=True)
            for name, image in of_kind.items()
        ],
        "seeds": _seeds(points),
        "cheapest": _cheapest(points),
        "exact_seconds": next((f"{p.wall_seconds:.2g}" for p in points if p.method == "exact"), None),
        "bench": _bench(results.settings["bench"]),
        "stability": _stability(results.settings["stability"]),
        "made_with": [
            agreeing for about in (_machine, _device, _programs) for agreeing in _agreeing(results.settings, about)
        ],
    }


def _points(results: Results) -> list[MethodMeasurement]:
    return [MethodMeasurement(**m) for m in results.settings["bench"]["measurements"]]


def _typeset(folder: Path) -> bytes:
    import typst

    # No system fonts, so that the report is the same on every machine.
    return typst.compile(str(folder / TEMPLATE[0]), root=str(folder), ignore_system_fonts=True)


def _pack(path: Path, files: Mapping[str, Path]) -> None:
    """A zip of ``files``, by their names in it, and of their SHA-256 sums for ``sha256sum --check``."""
    content = {name: files[name].read_bytes() for name in sorted(files)}
    sums = "".join(f"{hashlib.sha256(data).hexdigest()}  {name}\n" for name, data in content.items())
    with replacing(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for name, data in {SUMS: sums.encode(), **content}.items():
            entry = zipfile.ZipInfo(name)  # always dated 1980
            entry.create_system, entry.external_attr = 3, 0o100644 << 16
            archive.writestr(entry, data, zipfile.ZIP_DEFLATED)


def _percent(value: float) -> str:
    """A fraction as a percentage with three significant digits, never with an exponent."""
    if not np.isfinite(value):
        return "–"
    value *= 100
    digits = 2 if value == 0 else max(0, 2 - int(np.floor(np.log10(abs(value)))))
    return f"{value:.{min(digits, 6)}f}"


def _errors(image: np.ndarray, exact: np.ndarray) -> list[str]:
    """In percent: relative RMSE, largest error / exact image's maximum, mean error / exact image's mean."""
    mask = disc_mask(len(exact))
    difference = image[mask].astype(np.float64) - exact[mask]
    largest, mean = np.abs(difference).max() / exact.max(), difference.mean() / exact[mask].mean(dtype=np.float64)
    return [_percent(left_after_averaging(image, exact, 1)), _percent(largest), f"{100 * mean:+.3f}"]


def _averaged(image: np.ndarray, exact: np.ndarray) -> list[str]:
    """The error before and after averaging, in percent, and the ratio of the two."""
    before, after = (left_after_averaging(image, exact, side) for side in (1, AVERAGED))
    return [_percent(before), _percent(after), f"{before / after:.1f}" if after > 0 else "–"]


def _range(envmap: EnvironmentMap) -> dict[str, str]:
    """How concentrated the map's light is."""
    luminance = envmap.radiance.mean(axis=2, dtype=np.float64)
    mean = luminance.mean()
    brightest = np.sort(luminance, axis=None)[::-1].cumsum()
    pixels = int(np.searchsorted(brightest, brightest[-1] / 2)) + 1
    return {"peak_over_mean": f"{luminance.max() / mean:,.0f}", "half": f"{pixels:,}", "pixels": f"{luminance.size:,}"}


def _drawn(samples: Samples) -> list[str]:
    """N, how many different pixels were drawn, and for the likeliest of them: p, expected draws, draws."""
    pixels, times = np.unique(samples.pixel, axis=0, return_counts=True)
    likeliest = int(np.argmax(samples.probability))
    p = float(samples.probability[likeliest])
    drawn = int(times[(pixels == samples.pixel[likeliest]).all(axis=1)][0])
    return [str(len(samples)), str(len(pixels)), f"{100 * p:.3f}", f"{p * len(samples):.2f}", str(drawn)]


def _fresnel(folder: Path) -> dict[str, object]:
    """The results of part 1, rounded for a table."""
    try:
        content = json.loads((folder / "fresnel.json").read_text(encoding="utf-8"))
    except OSError as error:
        raise LightdomeError(f"cannot read {folder / 'fresnel.json'}: {error.strerror}") from error
    return {name: value if value is None or name == "version" else f"{value:.6g}" for name, value in content.items()}


def _seeds(points: list[MethodMeasurement]) -> list[list[str]]:
    """For the benchmark's plainest shared and per-pixel methods: the error of one image, and of the mean of all."""
    return [
        [p.method, str(p.count), str(p.seeds), _percent(p.rmse), _percent(p.rmse_spread), f"{100 * p.bias:+.3f}"]
        for p in points
        if p.method in ("independent", "light")
    ]


def _cheapest(points: list[MethodMeasurement]) -> list[list[str]]:
    """For each error level: the fastest method, its count, error and milliseconds, or dashes if there is none."""
    rows = []
    for level in LEVELS:
        best = cheapest(points, level)
        found = [best.method, str(best.count), _percent(best.rmse), f"{1e3 * best.wall_seconds:.1f}"] if best else []
        rows.append([f"{100 * level:g}", *(found or ["–"] * 4)])
    return rows


def _bench(content: Mapping[str, Any]) -> dict[str, object]:
    points = content["measurements"]
    return {
        "resolution": content["options"]["resolution"],
        "seeds": content["options"]["seeds"],
        "repeats": content["options"]["repeats"],
        "peers": list(dict.fromkeys(p["method"] for p in points if p["peer"])),
        "absent": _absent(content),
    }


def _stability(content: Mapping[str, Any]) -> dict[str, object]:
    """A table for lightdome and for each peer; how many cases hold, fail and were skipped; the absent peers."""
    tables = {
        program: _table(program, [case for case in content["cases"] if case["program"] == program], content["columns"])
        for program in ("lightdome", *content["peers"])
    }
    own = tables.pop("lightdome")
    verdicts = [case["verdict"] for case in content["cases"] if case["program"] == "lightdome"]
    return {
        "draws": f"{content['options']['draws']:,}",
        "own": own,
        "peers": list(tables.values()),
        "absent": _absent(content),
        **{name.lower(): verdicts.count(name) for name in ("holds", "FAILS", "skipped")},
    }


def _table(program: str, cases: Sequence[Mapping[str, Any]], goals: Mapping[str, Any]) -> dict[str, object]:
    """The columns that apply (name, goal, meaning), and for each case its group, name, problem and coloured cells."""
    columns = {name: column for name, column in goals.items() if any(name in case["figures"] for case in cases)}
    rows = []
    for case in cases:
        cells = []
        for name, column in columns.items():
            value = float(case["figures"][name]) if name in case["figures"] else None
            misses = value is not None and not value <= column["goal"]
            shade = to_hex(tuple(stability_plot.colour(value, column["goal"])))
            cells.append({"text": stability.text(value), "fill": shade, "dark": misses})
        note = "" if case["verdict"] in ("holds", "measured") else case["verdict"]
        rows.append({"group": case["group"], "case": case["case"], "note": note, "cells": cells})
    heads = [[name, stability.text(column["goal"]), column["meaning"]] for name, column in columns.items()]
    return {"program": program, "columns": heads, "rows": rows}


def _absent(content: Mapping[str, Any]) -> list[str]:
    return [f"{name} ({reason})" for name, reason in content["absent"].items()]


def _agreeing(
    contents: Mapping[str, Mapping[str, Any]], describe: Callable[[Mapping[str, Any]], str]
) -> list[tuple[list[str], str]]:
    """Groups of results with the same text from ``describe``, and that text, if it is not empty."""
    groups: dict[str, list[str]] = {}
    for name, content in contents.items():
        groups.setdefault(describe(content), []).append(name)
    return [(names, text) for text, names in groups.items() if text]


def _machine(content: Mapping[str, Any]) -> str:
    """The machine and the versions that made a result."""
    machine = content["machine"]
    versions = ", ".join(f"{what} {number}" for what, number in content["versions"].items())
    return f"{machine['processor']}; {machine['cores']} cores; {machine['system']}; {versions}"


def _device(content: Mapping[str, Any]) -> str:
    """The device that computed a result, without the runs of spaces in some implementations' names."""
    device = content["device"]
    return f"OpenCL on {device['name']}, {' '.join(device['implementation'].split())}" if device else "no OpenCL device"


def _programs(content: Mapping[str, Any]) -> str:
    """The other programs that took part in a result."""
    found = [content["pbrt"]] if content.get("pbrt") else []
    for name, about in content.get("peers", {}).items():
        versions = ", ".join(f"{what} {about[what]}" for what in ("mitsuba", "llvm") if what in about)
        found.append(f"{name} ({versions})" if versions else name)
    return ", ".join(found)
