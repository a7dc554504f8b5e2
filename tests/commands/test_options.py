"""Every option of every script does what it says, and nothing else.

A case runs a script in this process with and without the option, or with two values, and states what must change and
what must not. The options are read from each script's parser; an option without a case fails.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import hashlib
import io
import json
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import OpenImageIO as oiio
import pytest
from helpers import SCRIPTS, module_of, open_once, stiff_radiance
from lightdome import pbrt, plotting
from lightdome.cache import cache_folder
from lightdome.errors import LightdomeError
from lightdome.evaluation import (
    benchmark,
    benchmark_plot,
    choice,
    peer_mitsuba_distribution,
    peers,
    report,
    roofline,
    roofline_plot,
    roofline_stages,
    stability,
    stability_cases,
)
from lightdome.evaluation.benchmark import MethodMeasurement
from lightdome.evaluation.metrics import relative_rmse
from lightdome.evaluation.stability import Case, Result
from lightdome.fresnel import plot
from lightdome.lighting.exact import exact
from lightdome.lighting.shade import shade_samples
from lightdome.maps import convert
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.images import auto_exposure, read_image, write_image
from lightdome.maps.sphere import sphere_exposure
from lightdome.names import ESTIMATORS, METHODS, SEED
from lightdome.opencl import device
from lightdome.rendering import Rendered, render, render_to_error, to_error
from lightdome.sampling.distribution import build_distribution
from lightdome.sampling.samples import Samples
from lightdome.viewer import display


@dataclass
class Ran:
    """The results of a run: its files by name, and its output."""

    out: Path
    said: str
    errors: str

    def __getitem__(self, name: str) -> bytes:
        return (self.out / name).read_bytes()

    def names(self, pattern: str = "*") -> set[str]:
        return {path.name for path in self.out.glob(pattern) if path.is_file()}

    def image(self, name: str) -> np.ndarray:
        return read_image(self.out / name)

    def picture(self, name: str) -> np.ndarray:
        """8-bit pixels."""
        source = oiio.ImageInput.open(str(self.out / name))
        pixels = source.read_image("uint8")
        source.close()
        return np.asarray(pixels)

    def json(self, name: str = "settings.json") -> dict:
        return json.loads(self[name])


Case_ = Callable[["World", pytest.MonkeyPatch], None]
CASES: dict[tuple[str, str], Case_] = {}


def option(name: str, *scripts: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Make a function the case for option ``name`` of ``scripts``; if there are several, it receives the script."""

    def keep(case: Callable[..., None]) -> Callable[..., None]:
        for script in scripts:
            assert (script, name) not in CASES
            CASES[script, name] = functools.partial(case, script=script) if len(scripts) > 1 else case
        return case

    return keep


class World:
    """A folder with small maps and samples in which scripts run; equal runs are done only once."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.device = open_once(None)
        self.radiance = {"map": stiff_radiance(16, 32), "other": stiff_radiance(16, 32, seed=7)}
        for name, radiance in self.radiance.items():
            write_image(folder / f"{name}.pfm", radiance)
        bad = self.radiance["map"].copy()
        bad[4, 9, 1], bad[5, 2] = -1, np.nan
        write_image(folder / "bad.pfm", bad)
        self.radiance["bad"] = self.radiance["map"].copy()
        self.radiance["bad"][4, 9, 1], self.radiance["bad"][5, 2] = 0, 0
        layers = np.dstack([self.radiance["map"], self.radiance["other"]])
        spec = oiio.ImageSpec(32, 16, 6, "float")
        spec.channelnames = ("R", "G", "B", "side.R", "side.G", "side.B")
        file = oiio.ImageOutput.create(str(folder / "layers.exr"))
        assert file.open(str(folder / "layers.exr"), spec)
        assert file.write_image(layers)
        file.close()
        distribution = build_distribution(self.device, EnvironmentMap(self.radiance["map"]))
        for count in (5, 40):
            distribution.sample(count).save(folder / f"samples_{count}.npz")
        self.kept: dict[tuple[str, ...], Ran] = {}

    def run(self, script: str, *arguments: object) -> Ran:
        words = (script, *map(str, arguments))
        out = Path(tempfile.mkdtemp(dir=self.folder)) / "out"
        said, errors = io.StringIO(), io.StringIO()
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(sys, "argv", [f"{script}.py", *words[1:], "--out", str(out)])
            patch.setattr(device, "open_device", open_once)
            main = module_of(script).main
            with contextlib.redirect_stdout(said), contextlib.redirect_stderr(errors):
                main()
        return Ran(out, said.getvalue(), errors.getvalue())

    def base(self, script: str, *more: object) -> Ran:
        """The script with its cheapest options and ``more``."""
        words = (script, *map(str, more))
        if words not in self.kept:
            self.kept[words] = self.run(script, *self.cheap(script, words), *more)
        return self.kept[words]

    def cheap(self, script: str, words: tuple[str, ...]) -> list[object]:
        options = {
            "part2_sample": ["--counts", 5, 40, "--marker", 1],
            "part3_shade": [self.folder / "samples_40.npz", self.folder / "samples_5.npz", "--resolution", 12],
            "part4_pbrt": ["--renderer", "opencl", "--spp", 4, 1, "--resolution", 12],
        }.get(script, [])
        on_map = script in MAPPED and "--map" not in words
        return [*options, *(["--map", self.folder / "map.pfm"] if on_map else [])]


MAPPED = ("part2_sample", "part4_pbrt", "bench", "roofline", "report")


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> World:
    return World(tmp_path_factory.mktemp("world"))


class Asked(Exception):
    """Carries the parser out of a script."""


def options_of(script: str) -> set[str]:
    """The options that a script's parser knows, by their long names, and its positional arguments."""

    def stop(parser: argparse.ArgumentParser, *_: object) -> None:
        raise Asked(parser)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(argparse.ArgumentParser, "parse_args", stop)
        patch.setattr(sys, "argv", [f"{script}.py"])
        with pytest.raises(Asked) as asked:
            module_of(script).main()
    actions = asked.value.args[0]._actions
    return {max(action.option_strings, key=len, default=action.dest) for action in actions} - {"--help"}


@pytest.mark.parametrize("name", SCRIPTS)
def test_every_option_has_a_case(name: str) -> None:
    assert options_of(name) == {option for of, option in CASES if of == name}


# ---- what several scripts share ----


def fake_measurements(patch: pytest.MonkeyPatch) -> list[SimpleNamespace]:
    """The benchmark without its work: records what it is asked to measure, and with what."""
    asked: list[SimpleNamespace] = []

    def measure_method(
        method: benchmark.Method, count: int, seeds: int, repeats: int, reference: np.ndarray
    ) -> MethodMeasurement:
        asked.append(SimpleNamespace(method=method, count=count, seeds=seeds, repeats=repeats, reference=reference))
        return MethodMeasurement(method.name, method.kind, count, seeds, 0.1, 0, 0, 0, 1, 0, 1)

    patch.setattr(benchmark, "measure_method", measure_method)
    patch.setattr(plotting, "save_figure", lambda *_: None)
    for name in ("error_against_time", "error_against_time_all", "error_against_count", "stages", "images"):
        patch.setattr(benchmark_plot, name, lambda *_: None)
    return asked


QUICK_BENCH = ("--methods", "r2", "--resolution", "9", "--counts", "4", "--spp", "2")


def fake_report(world: World, patch: pytest.MonkeyPatch, *arguments: object) -> SimpleNamespace:
    """A report without its work: the scripts that it would run, with their options, and its map."""
    asked = SimpleNamespace(runs={}, wanted={}, written=None)

    class Runs:
        def __init__(self, out: Path) -> None:
            self.out = out
            self.folders = {name: out / name for name in ("part2",)}
            files = {f"samples_{n}.npz": str(n) for n in (64, 256, 1024)}
            self.settings = {"part2": {"files": files}, "part4": {"pbrt": None, "options": {"pbrt": None}}}

        def need(self, name: str, script: str, record: str, wanted: object, *options: object) -> None:
            asked.runs[name] = " ".join([script, *map(str, options)])
            asked.wanted[name] = wanted

    patch.setattr(module_of("report"), "Runs", Runs)
    patch.setattr(report, "write", lambda *arguments: setattr(asked, "written", arguments) or 0)
    patch.setattr(pbrt, "find_pbrt", lambda path: path)
    asked.ran = world.base("report", *arguments)
    world.kept.clear()
    return asked


def sees(world: World, patch: pytest.MonkeyPatch, script: str, radiance: np.ndarray, *arguments: object) -> Ran | None:
    """Assert that ``script`` with ``arguments`` works on a map of this ``radiance``."""
    envmap = EnvironmentMap(radiance)
    if script == "report":
        asked = fake_report(world, patch, *arguments)
        np.testing.assert_array_equal(asked.written[1].radiance, radiance)
        given = " ".join(map(str, arguments))
        for name, command in asked.runs.items():
            assert (given in command) == (name in ("part2", "part4", "bench")), name
        sha256 = hashlib.sha256(radiance.data).hexdigest()
        assert asked.wanted["part2"]["map"]["sha256"] == asked.wanted["bench"]["map"]["sha256"] == sha256
        return asked.ran
    if script == "bench":
        asked = fake_measurements(patch)
        ran = world.run(script, *QUICK_BENCH, *arguments)
        np.testing.assert_array_equal(asked[0].reference, exact(world.device, envmap, 9))
        expected = benchmark.methods(world.device, envmap, 9)["r2"].run(4, 0)
        np.testing.assert_array_equal(asked[0].method.run(4, 0), expected)
        return ran
    if script == "roofline":
        asked = run_roofline(world, patch, *arguments)
        np.testing.assert_array_equal(asked.envmap.radiance, radiance)
        return asked.ran
    ran = world.base(script, *arguments)
    distribution = build_distribution(world.device, envmap)
    if script == "part2_sample":
        for count in (5, 40):
            samples, expected = Samples.load(ran.out / f"samples_{count}.npz"), distribution.sample(count)
            np.testing.assert_array_equal(samples.pixel, expected.pixel)
            np.testing.assert_array_equal(samples.radiance, expected.radiance)
            marked = radiance.copy()
            marked[samples.pixel[:, 1], samples.pixel[:, 0]] = (0, 0, 1)
            np.testing.assert_array_equal(ran.image(f"em_{count}.pfm"), marked)
        alone = world.base(script, *arguments, "--samples-only")
        np.testing.assert_array_equal(Samples.load(alone.out / "samples_40.npz").radiance, samples.radiance)
    else:
        for spp, expected in render(distribution, [1, 4], 12):
            np.testing.assert_array_equal(ran.image(f"sphere_{spp}spp.pfm"), expected)
    return ran


@option("--map", *MAPPED)
def _(world: World, patch: pytest.MonkeyPatch, script: str) -> None:
    ran = sees(world, patch, script, world.radiance["other"], "--map", world.folder / "other.pfm")
    assert str(world.folder / "other.pfm") in ran.said


@option("--layer", *MAPPED)
def _(world: World, patch: pytest.MonkeyPatch, script: str) -> None:
    sees(world, patch, script, world.radiance["map"], "--map", world.folder / "layers.exr")
    with pytest.MonkeyPatch.context() as again:
        sees(world, again, script, world.radiance["other"], "--map", world.folder / "layers.exr", "--layer=side")


@option("--sanitize", *MAPPED)
def _(world: World, patch: pytest.MonkeyPatch, script: str) -> None:
    bad = ("--map", world.folder / "bad.pfm")
    for more in ((), ("--samples-only",)) if script == "part2_sample" else ((),):
        with pytest.raises(LightdomeError, match="bad pixel"):
            world.run(script, *world.cheap(script, ("--map",)), *bad, *more)
    ran = sees(world, patch, script, world.radiance["bad"], *bad, "--sanitize", "black")
    assert "2 bad pixels were replaced" in ran.errors
    # An infinite pixel distinguishes the two ways.
    infinite = world.radiance["map"].copy()
    infinite[3, 3, 0] = np.inf
    write_image(world.folder / "infinite.pfm", infinite)
    for way in ("black", "clamp") if script == "part2_sample" else ():
        ran = world.base(script, "--map", world.folder / "infinite.pfm", "--sanitize", way, "--counts", "1")
        samples = Samples.load(ran.out / "samples_1.npz")  # the largest finite value outshines all
        assert (tuple(samples.pixel[0]) == (3, 3)) == (way == "clamp")
        if way == "clamp":
            assert samples.radiance[0, 0] == np.finfo(np.float32).max


@option("--flip", *MAPPED)
def _(world: World, patch: pytest.MonkeyPatch, script: str) -> None:
    radiance = np.ascontiguousarray(world.radiance["map"][::-1])
    sees(world, patch, script, radiance, "--map", world.folder / "map.pfm", "--flip")


@option("--projection", *MAPPED)
def _(world: World, patch: pytest.MonkeyPatch, script: str) -> None:
    cross = convert(world.radiance["map"], to="cube-cross", size=5)
    write_image(world.folder / "cross.pfm", cross)
    arguments = ("--map", world.folder / "cross.pfm", "--projection")
    sees(world, patch, script, cross, *arguments, "latlong")
    if script != "part2_sample":
        sees(world, patch, script, convert(cross, "cube-cross"), *arguments, "cube-cross")
        return
    ran = world.base(script, *arguments, "cube-cross")
    expected = build_distribution(world.device, EnvironmentMap(convert(cross, "cube-cross"))).sample(40)
    np.testing.assert_array_equal(Samples.load(ran.out / "samples_40.npz").radiance, expected.radiance)
    with pytest.raises(LightdomeError, match="only latitude-longitude maps"):
        world.base(script, *arguments, "cube-cross", "--samples-only")


@option("--convention", *MAPPED)
def _(world: World, patch: pytest.MonkeyPatch, script: str) -> None:
    write_image(world.folder / "skylibs.pfm", np.roll(world.radiance["map"], 24, axis=1))
    sees(world, patch, script, world.radiance["map"], "--map", world.folder / "skylibs.pfm", "--convention", "skylibs")


@option("--mirror", *MAPPED)
def _(world: World, patch: pytest.MonkeyPatch, script: str) -> None:
    radiance = np.ascontiguousarray(world.radiance["map"][:, ::-1])
    sees(world, patch, script, radiance, "--map", world.folder / "map.pfm", "--mirror")


@option("--rotate", *MAPPED)
def _(world: World, patch: pytest.MonkeyPatch, script: str) -> None:
    radiance = np.roll(world.radiance["map"], -3, axis=1)
    sees(world, patch, script, radiance, "--map", world.folder / "map.pfm", "--rotate", "33.75")
    # The convention first, then the mirror, then the rotation.
    radiance = np.ascontiguousarray(np.roll(np.roll(world.radiance["map"], -8, axis=1)[:, ::-1], -3, axis=1))
    more = ("--mirror", "--convention", "mitsuba", "--rotate", "33.75", "0.0", "360.0")
    with pytest.MonkeyPatch.context() as again:
        ran = sees(world, again, script, radiance, "--map", world.folder / "map.pfm", *more)
    if script == "part2_sample":
        options = ran.json()["options"]
        assert [options[name] for name in ("convention", "mirror", "rotate")] == ["mitsuba", True, [33.75, 0, 360]]
        ran = world.base(script, "--rotate", "10", "20", "30")
        expected = EnvironmentMap(world.radiance["map"]).rotated(10, 20, 30)
        samples = build_distribution(world.device, expected).sample(40)
        np.testing.assert_array_equal(Samples.load(ran.out / "samples_40.npz").radiance, samples.radiance)
        for bad in (["nan"], ["-inf"], ["1", "2"], ["1", "2", "3", "4"], ["left"]):
            with pytest.raises(SystemExit):
                world.run(script, "--rotate", *bad)
        for turn in (["1"], ["0", "20", "30"]):
            with pytest.raises(LightdomeError, match=r"whole columns, of which it has 32; .* --samples-only$"):
                world.base(script, "--samples-only", "--rotate", *turn)


@option("--device", "part2_sample", "part3_shade", "part4_pbrt", "bench", "roofline", "stability", "report")
def _(world: World, patch: pytest.MonkeyPatch, script: str) -> None:
    with pytest.raises(LightdomeError, match="no OpenCL device matches 'Voodoo 2'"):
        world.base(script, "--device", "Voodoo 2")
    if script == "report":
        asked = fake_report(world, patch, "--device", "0:0")
        assert {name for name, command in asked.runs.items() if "--device 0:0" not in command} == {"part1"}
        assert asked.written[0].handle == open_once("0:0").handle


@option(
    "--out", "part1_fresnel", "part2_sample", "part3_shade", "part4_pbrt", "bench", "roofline", "stability", "report"
)
def _(world: World, patch: pytest.MonkeyPatch, script: str) -> None:
    if script == "report":
        ran = fake_report(world, patch).ran
        assert ran.out.is_dir()
    elif script == "stability":
        ran = run_stability(world, patch).ran
        assert ran.names() == {f"stability.{kind}" for kind in ("csv", "json", "png")}
    elif script == "bench":
        fake_measurements(patch)
        ran = world.run(script, *QUICK_BENCH, "--map", world.folder / "map.pfm")
        assert ran.names() == {"bench.csv", "bench.json"}
    elif script == "roofline":
        ran = run_roofline(world, patch).ran
        assert ran.names() == {"roofline.csv", "roofline.json"}
    elif script == "part1_fresnel":
        patch.setattr(plot, "save", lambda *_: [])
        ran = world.run(script)
        assert ran.names() == {"fresnel.json", "settings.json"}
    else:
        ran = world.base(script)
        stems = {"part2_sample": "em_{}", "part3_shade": "sphere_{}", "part4_pbrt": "sphere_{}spp"}[script]
        counts = (1, 4) if script == "part4_pbrt" else (5, 40)
        images = {f"{stems.format(n)}.{kind}" for n in counts for kind in ("pfm", "ppm", "png")}
        samples = {f"samples_{n}.npz" for n in counts} if script == "part2_sample" else set()
        assert ran.names() == images | samples | {"settings.json"}
    assert str(ran.out) in ran.said


@option("--explain", "part2_sample", "part3_shade", "part4_pbrt")
def _(world: World, patch: pytest.MonkeyPatch, script: str) -> None:
    plain, explained = world.base(script), world.base(script, "--explain")
    assert "used: " not in plain.said
    assert "skipped: " not in plain.said
    assert " kernels: " not in plain.said
    added = explained.said.replace(str(explained.out), str(plain.out)).splitlines()
    assert [line for line in added if line in plain.said.splitlines()] == plain.said.splitlines()
    assert any("skipped: " in line for line in added)
    assert any(line.startswith("built ") for line in added)
    assert_same(plain, explained, "*.p*", "*.npz")


@option("--display", "part3_shade", "part4_pbrt")
def _(world: World, patch: pytest.MonkeyPatch, script: str) -> None:
    sent = []
    patch.setattr(display, "find_spec", lambda name: True)
    patch.setattr(display, "display", lambda *sent_to: sent.append(sent_to))
    ran = world.base(script, "--display", "localhost:15000")
    assert {(host, port) for host, port, _, _ in sent} == {("localhost", 15000)}
    assert {f"{name}.pfm" for _, _, name, _ in sent} == ran.names("*.pfm")
    for _, _, name, image in sent:
        np.testing.assert_array_equal(image, ran.image(f"{name}.pfm"))


# ---- pictures ----


def assert_same(one: Ran, other: Ran, *patterns: str) -> None:
    names = [name for pattern in patterns for name in one.names(pattern)]
    assert names
    for name in names:
        assert one[name] == other[name], name


def assert_toned(ran: Ran, linear: dict[str, np.ndarray], exposure: float, gamma: float) -> None:
    """Assert that pictures are 255 (exposure x radiance)^(1 / gamma), clipped to white."""
    for name, radiance in linear.items():
        white = np.clip(radiance.astype(np.float64) * exposure, 0, 1)
        expected = 255 * white ** (1 / gamma)
        for kind in ("ppm", "png"):
            assert np.abs(ran.picture(f"{name}.{kind}") - expected).max() <= 0.51, name
        assert len(np.unique(ran.picture(f"{name}.png"))) > 10


PICTURED = ("part2_sample", "part3_shade", "part4_pbrt")


def linear(world: World, ran: Ran, script: str) -> dict[str, np.ndarray]:
    """The radiance of each picture; markers are blue in both."""
    names = {path.removesuffix(".pfm") for path in ran.names("*.pfm")}
    return {name: ran.image(f"{name}.pfm") for name in names if script != "part2_sample" or name.startswith("em")}


def automatic(world: World, ran: Ran, script: str) -> float:
    """The automatic exposure: that of the map, of the image with the most samples, or of the exact image."""
    if script == "part2_sample":
        return auto_exposure(world.radiance["map"])
    if script == "part4_pbrt":
        return sphere_exposure(EnvironmentMap(world.radiance["map"]))
    exposures = [auto_exposure(ran.image(f"sphere_{name}.pfm")) for name in ("40", "5")]
    assert exposures[0] != pytest.approx(exposures[1], rel=0.005)
    return exposures[0]


def marked(world: World, ran: Ran, script: str) -> dict[str, np.ndarray]:
    """Like :func:`linear`, with markers that stay blue at any exposure, outlined in white."""
    images = linear(world, ran, script)
    if script == "part2_sample":
        for image in images.values():
            blue = (image == (0, 0, 1)).all(axis=2)
            around = np.pad(np.pad(blue, ((1, 1), (0, 0))), ((0, 0), (1, 1)), mode="wrap")
            image[np.lib.stride_tricks.sliding_window_view(around, (3, 3)).any(axis=(2, 3))] = 1e30
            image[blue] = (0, 0, 1e30)
    return images


@option("--gamma", *PICTURED)
def _(world: World, patch: pytest.MonkeyPatch, script: str) -> None:
    plain, steep = world.base(script), world.base(script, "--gamma", 1.3)
    exposure = automatic(world, plain, script)
    assert_toned(plain, marked(world, plain, script), exposure, 2.2)
    assert_toned(steep, marked(world, steep, script), exposure, 1.3)
    assert_same(plain, steep, "*.pfm")
    assert plain.said.splitlines()[-1] == f"exposure {exposure:.4g}, gamma 2.2"
    assert steep.said.splitlines()[-1] == f"exposure {exposure:.4g}, gamma 1.3"


@option("--exposure", *PICTURED)
def _(world: World, patch: pytest.MonkeyPatch, script: str) -> None:
    plain = world.base(script)
    exposure = 0.37 * automatic(world, plain, script)
    dim = world.base(script, "--exposure", exposure)
    assert_toned(dim, marked(world, dim, script), exposure, 2.2)
    assert_same(plain, dim, "*.pfm")
    assert f"exposure {exposure}," in dim.said
    assert_same(plain, world.base(script, "--exposure", "auto"), "*.pfm", "*.ppm", "*.png")


@option("--format", *PICTURED)
def _(world: World, patch: pytest.MonkeyPatch, script: str) -> None:
    plain, other = world.base(script), world.base(script, "--format", "exr", "png")
    images = {path.removesuffix(".pfm") for path in plain.names("*.pfm")}
    assert other.names() - other.names("*.npz") == {f"{n}.{s}" for n in images for s in ("exr", "png")} | {
        "settings.json"
    }
    for name in images:
        np.testing.assert_array_equal(other.image(f"{name}.exr"), plain.image(f"{name}.pfm"))
    assert_same(other, plain, "*.png", "*.npz") if script == "part2_sample" else assert_same(other, plain, "*.png")
    assert set(other.json()["files"]) == other.names() - {"settings.json"}
    assert ".exr, .png" in other.said


@option("--albedo", "part3_shade", "part4_pbrt")
def _(world: World, patch: pytest.MonkeyPatch, script: str) -> None:
    white, grey = world.base(script), world.base(script, "--albedo", 0.5)
    names = white.names("*.pfm")
    assert names
    for name in names:
        np.testing.assert_array_equal(grey.image(name), white.image(name) / 2)
    # The exposure compensates for it.
    assert_same(white, grey, "*.png", "*.ppm")
    if script == "part4_pbrt":
        assert white.names("pbrt/*.pbrt") == grey.names("pbrt/*.pbrt") != set()
        for name in grey.names("pbrt/*.pbrt"):
            assert b"0.5" in grey[f"pbrt/{name}"]
            assert white[f"pbrt/{name}"] != grey[f"pbrt/{name}"]


@option("--resolution", "part3_shade", "part4_pbrt")
def _(world: World, patch: pytest.MonkeyPatch, script: str) -> None:
    ran = world.base(script, "--resolution", 19)
    envmap = EnvironmentMap(world.radiance["map"])
    if script == "part3_shade":
        for count in (5, 40):
            samples = Samples.load(world.folder / f"samples_{count}.npz")
            expected = shade_samples(world.device, samples, 19)
            np.testing.assert_array_equal(ran.image(f"sphere_{count}.pfm"), expected)
    else:
        for spp, expected in render(build_distribution(world.device, envmap), [1, 4], 19):
            np.testing.assert_array_equal(ran.image(f"sphere_{spp}spp.pfm"), expected)
        scenes = ran.names("pbrt/*.pbrt")
        assert len(scenes) == 4
        for name in scenes:
            assert b'"integer xresolution" [19]' in ran[f"pbrt/{name}"]


# ---- parts 1 to 4 ----


@option("--eta", "part1_fresnel")
def _(world: World, patch: pytest.MonkeyPatch) -> None:
    for eta in (1.4, 1.7):
        drawn = {}
        patch.setattr(plot, "save", lambda figure, stem, drawn=drawn: drawn.update({stem.name: figure}) or [])
        ran = world.run("part1_fresnel", *(["--eta", eta] if eta != 1.4 else []))
        assert ran.json("fresnel.json")["eta"] == eta
        assert ran.said.startswith(f"eta {eta},")
        for way, title in (
            ("entering", f"air ($n_i$ = 1) to material ($n_t$ = {eta})"),
            ("leaving", f"material ($n_i$ = {eta}) to air ($n_t$ = 1)"),
        ):
            for what in ("fresnel", "schlick"):
                axes = drawn[f"{what}_{way}"].axes[0]
                assert axes.get_title().endswith(title)
                first = next(line for line in axes.lines if line.get_label().endswith("unpolarised"))
                assert first.get_ydata()[0] == pytest.approx(((eta - 1) / (eta + 1)) ** 2)
                if what == "fresnel":
                    p = next(line for line in axes.lines if "parallel" in line.get_label())
                    at = p.get_xdata()[np.argmin(p.get_ydata())]
                    assert at == pytest.approx(np.degrees(np.arctan(eta if way == "entering" else 1 / eta)))


@option("--counts", "part2_sample")
def _(world: World, patch: pytest.MonkeyPatch) -> None:
    ran = world.base("part2_sample", "--counts", 7, 3, 7)
    assert ran.names("*.npz") == {"samples_3.npz", "samples_7.npz"}
    assert ran.names("em_*.pfm") == {"em_3.pfm", "em_7.pfm"}
    assert [len(Samples.load(ran.out / f"samples_{n}.npz")) for n in (3, 7)] == [3, 7]


@option("--seed", "part2_sample", "part4_pbrt")
def _(world: World, patch: pytest.MonkeyPatch, script: str) -> None:
    plain, other = world.base(script), world.base(script, "--seed", 9)
    distribution = build_distribution(world.device, EnvironmentMap(world.radiance["map"]))
    for ran, seed in ((plain, SEED), (other, 9)):
        if script == "part2_sample":
            alone = world.base(script, "--seed", seed, "--samples-only")
            for count in (5, 40):
                expected = distribution.sample(count, seed)
                for found in (ran, alone):
                    samples = Samples.load(found.out / f"samples_{count}.npz")
                    np.testing.assert_array_equal(samples.pixel, expected.pixel)
                    assert samples.seed == seed
        else:
            for spp, expected in render(distribution, [1, 4], 12, 1.0, seed):
                np.testing.assert_array_equal(ran.image(f"sphere_{spp}spp.pfm"), expected)
            envmap = EnvironmentMap(world.radiance["map"])
            (world.folder / f"scenes {seed}").mkdir()
            for scene in pbrt.write_scenes(world.folder / f"scenes {seed}", envmap, [1, 4], 12, 1.0, seed):
                assert ran[f"pbrt/{scene.path.name}"] == scene.path.read_bytes()
    assert other.json()["options"]["seed"] == 9
    name = "samples_40.npz" if script == "part2_sample" else "sphere_4spp.pfm"
    assert plain[name] != other[name]


@option("--sequence", "part2_sample")
def _(world: World, patch: pytest.MonkeyPatch) -> None:
    distribution = build_distribution(world.device, EnvironmentMap(world.radiance["map"]))
    for sequence in ("independent", "sobol", "r2"):
        options = () if sequence == "independent" else ("--sequence", sequence)
        for more in ((), ("--samples-only",)):
            samples = Samples.load(world.base("part2_sample", *options, *more).out / "samples_40.npz")
            assert samples.sequence == sequence
            np.testing.assert_array_equal(samples.pixel, distribution.sample(40, sequence=sequence).pixel)


@option("--within", "part2_sample")
def _(world: World, patch: pytest.MonkeyPatch) -> None:
    distribution = build_distribution(world.device, EnvironmentMap(world.radiance["map"]))
    for within in ("centre", "pixel"):
        for more in ((), ("--samples-only",)):
            samples = Samples.load(world.base("part2_sample", "--within", within, *more).out / "samples_40.npz")
            expected = distribution.sample(40, within=within)
            np.testing.assert_array_equal(samples.direction, expected.direction)


@option("--marker", "part2_sample")
def _(world: World, patch: pytest.MonkeyPatch) -> None:
    ran = world.base("part2_sample", "--marker", 3)
    expected = np.zeros((16, 32), bool)
    for x, y in Samples.load(ran.out / "samples_5.npz").pixel:
        for dy in (-1, 0, 1):
            for dx in (-1, 0, 1):
                if 0 <= y + dy < 16:
                    expected[y + dy, (x + dx) % 32] = True
    for image, blue in ((ran.image("em_5.pfm"), (0, 0, 1)), (ran.picture("em_5.png"), (0, 0, 255))):
        np.testing.assert_array_equal((image == blue).all(axis=2), expected)
    assert_same(world.base("part2_sample"), ran, "*.npz")


@option("--samples-only", "part2_sample")
def _(world: World, patch: pytest.MonkeyPatch) -> None:
    plain, alone = world.base("part2_sample"), world.base("part2_sample", "--samples-only")
    assert alone.names() == {"samples_5.npz", "samples_40.npz", "settings.json"}
    assert_same(alone, plain, "*.npz")


@option("samples", "part3_shade")
def _(world: World, patch: pytest.MonkeyPatch) -> None:
    ran = world.base("part3_shade")
    for count in (5, 40):
        expected = shade_samples(world.device, Samples.load(world.folder / f"samples_{count}.npz"), 12)
        np.testing.assert_array_equal(ran.image(f"sphere_{count}.pfm"), expected)
    one = world.run("part3_shade", world.folder / "samples_5.npz", "--resolution", 12)
    assert one.names("*.pfm") == {"sphere_5.pfm"}
    assert one["sphere_5.pfm"] == ran["sphere_5.pfm"]
    exposure = auto_exposure(one.image("sphere_5.pfm"))
    assert one.said.splitlines()[-1] == f"exposure {exposure:.4g}, gamma 2.2"


@option("--spp", "part4_pbrt")
def _(world: World, patch: pytest.MonkeyPatch) -> None:
    ran = world.base("part4_pbrt", "--spp", 3, 2)
    assert ran.names("*.pfm") == {"sphere_2spp.pfm", "sphere_3spp.pfm"}
    distribution = build_distribution(world.device, EnvironmentMap(world.radiance["map"]))
    for spp, expected in render(distribution, [2, 3], 12):
        np.testing.assert_array_equal(ran.image(f"sphere_{spp}spp.pfm"), expected)


def stand_in_pbrt(patch: pytest.MonkeyPatch) -> list[Path | None]:
    """Stand in for PBRT, with uniform images; returns where it was looked for."""
    asked: list[Path | None] = []

    even = np.full((12, 12, 3), 0.25, np.float32)
    patch.setattr(pbrt, "find_pbrt", lambda path: asked.append(path) or pbrt.Pbrt(Path("the stand-in"), 4))
    patch.setattr(pbrt, "render", lambda _, scenes: iter({s.spp: (s.spp, even) for s in scenes}.values()))
    return asked


def part4(world: World, *arguments: object) -> Ran:
    fixed = ("--map", world.folder / "map.pfm", "--spp", 1, "--resolution", 12)
    return world.run("part4_pbrt", *fixed, *arguments)


@option("--renderer", "part4_pbrt")
def _(world: World, patch: pytest.MonkeyPatch) -> None:
    asked = stand_in_pbrt(patch)
    for options, by_pbrt in (
        ((), True),
        (("--renderer", "auto"), True),
        (("--renderer", "pbrt"), True),
        (("--renderer", "opencl"), False),
    ):
        ran = part4(world, *options)
        assert bool(asked) == by_pbrt
        asked.clear()
        assert (ran.image("sphere_1spp.pfm") == 0.25).all() == by_pbrt
        assert ("renderer: PBRT-v4 (the stand-in)" if by_pbrt else "renderer: opencl") in ran.said
        assert ran.json()["pbrt"] == ("PBRT-v4" if by_pbrt else None)

    def missing(path: Path | None) -> None:
        raise LightdomeError("no pbrt; get one")

    patch.setattr(pbrt, "find_pbrt", missing)
    assert "renderer: opencl, because: no pbrt" in part4(world).said
    with pytest.raises(LightdomeError, match="no pbrt"):
        part4(world, "--renderer", "pbrt")


def rendered(world: World, patch: pytest.MonkeyPatch, name: str, values: dict[str, str]) -> None:
    """An option of our own renderer makes part 4 use that renderer, and is refused together with PBRT."""
    asked = stand_in_pbrt(patch)
    distribution = build_distribution(world.device, EnvironmentMap(world.radiance["map"]))
    for value, estimator in values.items():
        options = {"estimator": estimator, name: value}
        ran = part4(world, *(word for option in options for word in (f"--{option}", options[option])))
        ((_, expected),) = render(distribution, [1], 12, **options)
        np.testing.assert_array_equal(ran.image("sphere_1spp.pfm"), expected)
        assert ran.json()["options"][name] == value
        for by_pbrt in (("--renderer", "pbrt"), ("--pbrt", "/opt/pbrt")):
            with pytest.raises(SystemExit, match="2"):
                part4(world, f"--{name}", value, *by_pbrt)
    assert not asked


@option("--estimator", "part4_pbrt")
def _(world: World, patch: pytest.MonkeyPatch) -> None:
    rendered(world, patch, "estimator", {name: name for name in ESTIMATORS})
    options = part4(world, "--renderer", "opencl").json()["options"]
    assert [options[name] for name in ("estimator", "sequence", "within")] == ["light", "independent", None]


@option("--sequence", "part4_pbrt")
def _(world: World, patch: pytest.MonkeyPatch) -> None:
    rendered(world, patch, "sequence", {"independent": "light", "sobol": "mis"})


@option("--within", "part4_pbrt")
def _(world: World, patch: pytest.MonkeyPatch) -> None:
    rendered(world, patch, "within", {"centre": "light", "pixel": "product"})
    with pytest.raises(SystemExit, match="2"):
        part4(world, "--within", "centre", "--estimator", "bsdf")


@option("--light-share", "part4_pbrt")
def _(world: World, patch: pytest.MonkeyPatch) -> None:
    distribution = build_distribution(world.device, EnvironmentMap(world.radiance["map"]))
    ran = part4(world, "--estimator", "mis", "--light-share", 0.9, "--spp", 4)
    ((_, expected),) = render(distribution, [4], 12, estimator="mis", light_share=0.9)
    np.testing.assert_array_equal(ran.image("sphere_4spp.pfm"), expected)
    for refused in (("--estimator", "light", "--light-share", 0.9), ("--estimator", "mis", "--light-share", 1)):
        with pytest.raises(SystemExit, match="2"):
            part4(world, *refused)


def until(world: World, *arguments: object) -> Ran:
    """Part 4 with options for the error."""
    return world.run("part4_pbrt", "--map", world.folder / "map.pfm", "--resolution", 12, *arguments)


@option("--error", "part4_pbrt")
def _(world: World, patch: pytest.MonkeyPatch) -> None:
    distribution = build_distribution(world.device, EnvironmentMap(world.radiance["map"]))
    for options, wanted in (
        (("--error", "20%"), {}),
        (("--error", "0.3", "--estimator", "mis", "--seed", 7), {"estimator": "mis", "seed": 7}),
        (("--error", "30%", "--sequence", "sobol", "--within", "pixel"), {"sequence": "sobol", "within": "pixel"}),
        (("--error", "30%", "--albedo", 0.5), {"albedo": 0.5}),
    ):
        ran = until(world, *options)
        expected = render_to_error(distribution, 0.2 if "20%" in options else 0.3, resolution=12, **wanted)
        np.testing.assert_array_equal(ran.image("sphere.pfm"), expected.image)
        np.testing.assert_array_equal(ran.image("error.pfm"), expected.error[..., None].repeat(3, axis=2))
        reached = ran.json()["reached"]
        assert (reached["reason"], reached["spp"]) == ("error", expected.spp)
        assert (reached["relative_rmse"], tuple(reached["interval"])) == (expected.rmse, expected.interval)
        assert f"stopped after {expected.spp} spp" in ran.said
        assert f"error: {100 * expected.rmse:.3g} %, 95 % interval {100 * expected.interval[0]:.3g} to" in ran.said
        images = {"sphere.pfm", "sphere.ppm", "sphere.png", "error.pfm", "error.png"}
        assert ran.names() == images | {"settings.json"}
        assert set(ran.json()["files"]) == images
        assert not (ran.out / "pbrt").exists()
    note = "note: the estimate does not include light that no sample has hit"
    assert note in until(world, "--error", "90%", "--estimator", "bsdf").errors
    assert note not in ran.errors
    assert ran.picture("error.png").shape[:2] > (300, 300)
    assert until(world, "--error", "30%", "--format", "exr").names() == {"sphere.exr", "error.exr", "settings.json"}
    assert "note: the image of the error is written as" in until(world, "--error", "30%", "--format", "ppm").errors
    assert "at most 51.2345 %" in until(world, "--error", "51.2345%").said
    assert "the image is black" in until(world, "--error", "30%", "--albedo", 0).said
    for wrong in ("0", "0%", "101%", "1e-6", "-1%", "nan", "one", "%", "1", "50"):
        with pytest.raises(SystemExit, match="2"):
            until(world, f"--error={wrong}")
    for more in (
        ("--spp", 4),
        ("--renderer", "pbrt"),
        ("--pbrt", "/opt/pbrt"),
        ("--estimator", "mis", "--light-share", 0.5),
    ):
        with pytest.raises(SystemExit, match="2"):
            until(world, "--error", "30%", *more)


@option("--time", "part4_pbrt")
def _(world: World, patch: pytest.MonkeyPatch) -> None:
    asked: list[float] = []

    def record(distribution: object, error: float, seconds: float, *arguments: object, **options: object) -> Rendered:
        asked.append(seconds)
        found = render_to_error(distribution, error, seconds, *arguments, **options)
        return replace(found, rmse=np.inf, interval=(0.0, np.inf)) if seconds < 1e-3 else found

    with patch.context() as missed:
        missed.setattr(to_error, "_is_darker", lambda *_: True)
        ran = until(world, "--error", "90%", "--time", "0.1ms", "--estimator", "bsdf")
        assert "the samples have missed light of the map\nerror: unknown" in ran.said
    patch.setattr(to_error, "render_to_error", record)
    for text, seconds in (("10", 10), ("2.5s", 2.5), ("500ms", 0.5), ("0.1ms", 1e-4)):
        ran = until(world, "--error", "0.001%" if text == "0.1ms" else "50%", "--time", text, "--estimator", "light")
        assert asked.pop() == pytest.approx(seconds)
    assert ran.json()["reached"]["reason"] == "time"
    assert (ran.json()["reached"]["relative_rmse"], ran.json()["reached"]["interval"]) == (None, [0, None])
    assert "the time is up, but the error may be above 0.001 %" in ran.said
    assert "error: unknown: the noise is larger than the image" in ran.said
    for wrong in ("0", "-1s", "nan", "ms", "3 minutes", "inf"):
        with pytest.raises(SystemExit, match="2"):
            until(world, "--error", "30%", f"--time={wrong}")
    with pytest.raises(SystemExit, match="2"):
        until(world, "--time", "10s")


@option("--auto", "part4_pbrt")
def _(world: World, patch: pytest.MonkeyPatch) -> None:
    patch.setitem(choice.SHARED, "median-cut", (16,))  # with more lights than pixels, median cut is exact, too
    ran = until(world, "--auto", "--error", "0.001%")
    truth = exact(world.device, EnvironmentMap(world.radiance["map"]), 12)
    np.testing.assert_array_equal(ran.image("sphere.pfm"), truth)
    assert "chosen: exact: " in ran.said
    assert (ran.json()["reached"]["method"], ran.json()["reached"]["reason"]) == ("exact", None)
    ran = until(world, "--auto", "--error", "40%", "--within", "pixel", "--albedo", 0.5)
    truth = exact(world.device, EnvironmentMap(world.radiance["map"]), 12, 0.5, "areas")
    assert relative_rmse(ran.image("sphere.pfm"), truth) < 0.4
    assert "slower: exact: " in ran.said or "chosen: exact: " in ran.said
    assert ran.names("error.*") == {"error.pfm", "error.png"}
    for more in (("--estimator", "mis"), ("--sequence", "sobol"), ("--time", "1s"), ("--spp", 4)):
        with pytest.raises(SystemExit, match="2"):
            until(world, "--auto", "--error", "30%", *more)
    with pytest.raises(SystemExit, match="2"):
        until(world, "--auto")


@option("--pbrt", "part4_pbrt", "bench", "report")
def _(world: World, patch: pytest.MonkeyPatch, script: str) -> None:
    if script == "part4_pbrt":
        asked = stand_in_pbrt(patch)
        part4(world, "--pbrt", "/opt/pbrt")
        part4(world)
        assert asked == [Path("/opt/pbrt"), None]
    elif script == "bench":
        assert found_peers(world, patch, "--pbrt", "/opt/pbrt", "/opt/other") == (
            ["pbrt"],
            ["/opt/pbrt", "/opt/other"],
        )
    else:
        with pytest.MonkeyPatch.context() as alone:
            plain = fake_report(world, alone).runs
        with_it = fake_report(world, patch, "--pbrt", "/opt/pbrt").runs
        assert {name for name in plain if plain[name] != with_it[name].replace(" --pbrt /opt/pbrt", "")} <= {"part3"}
        assert "--pbrt" not in " ".join(plain.values())
        assert with_it["part4"].endswith("--pbrt /opt/pbrt")


# ---- benchmark, stability, report ----


def found_peers(world: World, patch: pytest.MonkeyPatch, *arguments: object) -> tuple[list[str], list[str]]:
    asked = []

    def find(names: list[str], envmap: EnvironmentMap, resolution: int, pbrts: list[object]) -> SimpleNamespace:
        asked.append((list(names), [str(path) for path in pbrts]))
        return SimpleNamespace(methods={}, absent={}, about={})

    fake_measurements(patch)
    patch.setattr(peers, "find", find)
    world.run("bench", *QUICK_BENCH, "--map", world.folder / "map.pfm", *arguments)
    return asked[0]


def measurements(world: World, *arguments: object) -> list[SimpleNamespace]:
    with pytest.MonkeyPatch.context() as patch:
        asked = fake_measurements(patch)
        world.run("bench", "--map", world.folder / "map.pfm", *arguments)
        return asked


@option("--counts", "bench")
def _(world: World, patch: pytest.MonkeyPatch) -> None:
    asked = measurements(world, "--methods", "r2", "light", "--resolution", 9, "--counts", 6, 3, "--spp", 2)
    assert [(a.method.name, a.count) for a in asked] == [("r2", 3), ("r2", 6), ("light", 2)]


@option("--spp", "bench")
def _(world: World, patch: pytest.MonkeyPatch) -> None:
    asked = measurements(world, "--methods", "r2", "light", "--resolution", 9, "--counts", 6, "--spp", 4, 3)
    assert [(a.method.name, a.count) for a in asked] == [("r2", 6), ("light", 3), ("light", 4)]


@option("--methods", "bench")
def _(world: World, patch: pytest.MonkeyPatch) -> None:
    options = ("--resolution", 9, "--counts", 4, "--spp", 1)
    all_of_them = benchmark.methods
    black = np.zeros((9, 9, 3), np.float32)
    patch.setattr(
        benchmark,
        "methods",
        lambda *arguments: {n: replace(m, run=lambda *_: black) for n, m in all_of_them(*arguments).items()},
    )
    assert {a.method.name for a in measurements(world, *options)} == set(METHODS)
    chosen = measurements(world, *options, "--methods", "sobol", "bsdf")
    assert [a.method.name for a in chosen] == ["sobol", "bsdf"]


@option("--explain", "bench")
def _(world: World, patch: pytest.MonkeyPatch) -> None:
    options = ("--map", world.folder / "map.pfm", "--resolution", 9, "--counts", 4, "--spp", 1, "--seeds", 1)
    ran = world.run("bench", *options, "--repeats", 1, "--methods", "sobol", "light", "--explain")
    assert "\nsobol 4: skipped: guide tables; " in ran.said
    assert "\nlight 1: used: guide tables; " in ran.said


@option("--peers", "bench", "stability")
def _(world: World, patch: pytest.MonkeyPatch, script: str) -> None:
    if script == "bench":
        assert found_peers(world, patch) == ([], [])
        assert found_peers(world, patch, "--peers", "numpy", "pbrt") == (["numpy", "pbrt"], [])
        return
    plain, peered = run_stability(world, patch), run_stability(world, patch, "--peers", "mitsuba")
    assert plain.peer == []
    assert [case for case, _ in peered.peer] == ["mapped"]
    assert plain.own == peered.own
    assert {case["program"] for case in peered.ran.json("stability.json")["cases"]} == {"lightdome", "mitsuba"}
    assert {case["program"] for case in plain.ran.json("stability.json")["cases"]} == {"lightdome"}


@option("--resolution", "bench")
def _(world: World, patch: pytest.MonkeyPatch) -> None:
    (asked,) = measurements(world, *QUICK_BENCH, "--resolution", 14)
    assert asked.reference.shape == asked.method.run(4, 0).shape == (14, 14, 3)


@option("--seeds", "bench")
def _(world: World, patch: pytest.MonkeyPatch) -> None:
    plain, more = (measurements(world, *QUICK_BENCH, *o)[0] for o in ((), ("--seeds", 11)))
    assert (plain.seeds, plain.repeats) == (8, 5)
    assert (more.seeds, more.repeats) == (11, 5)


@option("--repeats", "bench")
def _(world: World, patch: pytest.MonkeyPatch) -> None:
    (asked,) = measurements(world, *QUICK_BENCH, "--repeats", 11)
    assert (asked.seeds, asked.repeats) == (8, 11)


@option("--quick", "bench")
def _(world: World, patch: pytest.MonkeyPatch) -> None:
    asked = measurements(world, "--methods", "r2", "light", "--quick")
    assert {(a.seeds, a.repeats, len(a.reference)) for a in asked} == {(3, 3, 255)}
    assert [(a.method.name, a.count) for a in asked] == [
        *(("r2", n) for n in (16, 64, 256, 1024)),
        *(("light", n) for n in (8, 32)),
    ]
    # Options that are given hold nevertheless.
    own = ("--resolution", 9, "--seeds", 4, "--repeats", 6, "--counts", 5, "--spp", 2)
    asked = measurements(world, "--methods", "r2", "light", "--quick", *own)
    assert {(a.seeds, a.repeats, len(a.reference)) for a in asked} == {(4, 6, 9)}
    assert [a.count for a in asked] == [5, 2]


def run_roofline(world: World, patch: pytest.MonkeyPatch, *arguments: object) -> SimpleNamespace:
    """The roofline without its work: records what was planned, and for which map."""
    asked = SimpleNamespace()
    limits = roofline.Limits({2**21: 1e9}, 1e9, 1e-6)
    stage = roofline_stages.Stage("a", print, roofline_stages.Work(1, 1, 1, "samples"))
    patch.setattr(roofline, "measure_limits", lambda _: limits)
    patch.setattr(roofline, "time_stage", lambda _, stage, repeats: roofline.Timing(stage, repeats, 0, repeats, None))

    def plan(_: object, envmap: EnvironmentMap, name: str, *sizes: object, N: int) -> list[tuple[float, object]]:
        asked.envmap, asked.planned = envmap, (name, *map(list, (sizes[0], sizes[1])), sizes[2], list(sizes[3]))
        return [(0.5, stage)]

    patch.setattr(roofline_stages, "plan", plan)
    patch.setattr(plotting, "save_figure", lambda *_: None)
    for name in ("roofline", "scaling"):
        patch.setattr(roofline_plot, name, lambda *_: None)
    asked.ran = world.run("roofline", *world.cheap("roofline", tuple(map(str, arguments))), *arguments)
    asked.repeats = asked.ran.json("roofline.json")["measurements"][0]["repeats"]
    return asked


@option("--resolution", "roofline")
def _(world: World, patch: pytest.MonkeyPatch) -> None:
    plain, larger = run_roofline(world, patch), run_roofline(world, patch, "--resolution", 600)
    assert plain.planned[2:4] == ([255, 511, 2047], 511)
    assert larger.planned[2:4] == ([255, 511, 600, 2047], 600)


@option("--repeats", "roofline")
def _(world: World, patch: pytest.MonkeyPatch) -> None:
    assert [run_roofline(world, patch, *more).repeats for more in ((), ("--repeats", 7))] == [5, 7]


@option("--quick", "roofline")
def _(world: World, patch: pytest.MonkeyPatch) -> None:
    whole, quick = run_roofline(world, patch), run_roofline(world, patch, "--quick")
    assert whole.planned == (
        "map.pfm",
        [512, 2048, 8192],
        [255, 511, 2047],
        511,
        [64, 1024, 16384, 131072, 1048576],
    )
    assert quick.planned == ("map.pfm", [512, 2048], [255, 511], 255, [64, 1024, 65536])
    assert quick.repeats == 3
    # Options that are given hold nevertheless.
    own = run_roofline(world, patch, "--quick", "--repeats", 7, "--resolution", 300)
    assert own.planned == ("map.pfm", [512, 2048], [255, 300, 511], 300, [64, 1024, 65536])
    assert own.repeats == 7


def run_stability(world: World, patch: pytest.MonkeyPatch, *arguments: object) -> SimpleNamespace:
    """The stability table without its work: records the cases, each with its number of draws."""
    asked = SimpleNamespace(own=[], peer=[])
    small = Case("small", "g", lambda *_: [])
    cases = [small, Case("mapped", "g", lambda *_: [], maps=list), Case("large", "g", lambda *_: [], large=True)]
    patch.setattr(stability_cases, "CASES", cases)

    def run(case: Case, device: object, draws: int) -> Result:
        asked.own.append((case.name, draws))
        return Result("lightdome", case.group, case.name, {"p": 1e-7})

    def run_peer(case: Case, name: str, sampler: object, draws: int) -> Result:
        asked.peer.append((case.name, draws))
        return Result(name, case.group, case.name, {"p": 1e-7}, judged=False)

    patch.setattr(stability, "run", run)
    patch.setattr(stability, "run_peer", run_peer)
    stand_in = contextlib.nullcontext(SimpleNamespace(about={"mitsuba": "3"}, sampler=None))
    patch.setattr(peer_mitsuba_distribution, "start", lambda: stand_in)
    asked.ran = world.run("stability", *arguments)
    return asked


@option("--quick", "stability")
def _(world: World, patch: pytest.MonkeyPatch) -> None:
    quick, whole = run_stability(world, patch, "--quick"), run_stability(world, patch)
    assert quick.own == [("small", 200_000), ("mapped", 200_000)]
    assert whole.own == [("small", 10_000_000), ("mapped", 10_000_000), ("large", 10_000_000)]
    assert [a.ran.json("stability.json")["options"]["draws"] for a in (quick, whole)] == [200_000, 10_000_000]


@option("--quick", "report")
def _(world: World, patch: pytest.MonkeyPatch) -> None:
    with pytest.MonkeyPatch.context() as alone:
        whole = fake_report(world, alone)
    quick = fake_report(world, patch, "--quick")
    for asked, is_quick, resolution in ((whole, False, 511), (quick, True, 255)):
        assert {name for name in asked.runs if "--quick" in asked.runs[name]} == (
            {"bench", "stability"} if is_quick else set()
        )
        for part in ("part3", "part4"):
            assert f"--resolution {resolution}" in asked.runs[part]
            assert asked.wanted[part]["options"]["resolution"] == resolution
        for name in ("bench", "stability"):
            assert asked.wanted[name]["options"]["quick"] == is_quick


# ---- maps ----


@option("--out", "make_default_map")
def _(world: World, patch: pytest.MonkeyPatch) -> None:
    pixels = world.radiance["map"].clip(0, 1000).astype(np.float16)
    found = module_of("make_default_map")
    found.render = lambda: pixels
    path = world.folder / "made.exr"
    patch.setattr(sys, "argv", ["make_default_map.py", "--out", str(path)])
    found.main()
    np.testing.assert_array_equal(read_image(path), pixels.astype(np.float32))


@option("--from", "get_grace")
@option("--out", "get_grace")
def _(world: World, patch: pytest.MonkeyPatch) -> None:
    found = module_of("get_grace")
    asked: list[tuple[object, ...]] = []
    found.fetch = lambda *arguments: asked.append(arguments)
    for name in ("signal", "setitimer"):  # in this process they belong to the tests
        patch.setattr(signal, name, lambda *_: None)
    out = world.folder / "g.exr"
    for options in (["--from", "here.exr", "--out", str(out)], ["--out", str(out)]):
        patch.setattr(sys, "argv", ["get_grace.py", *options])
        found.main()
    assert asked == [("here.exr", out), (found.URL, out)]


@option("--out", "get_pbrt")
def _(world: World, patch: pytest.MonkeyPatch) -> None:
    found = module_of("get_pbrt")
    asked: list[list[str]] = []
    failed = SimpleNamespace(wait=lambda: 1, poll=lambda: 1)
    patch.setattr(shutil, "which", lambda *_, **__: "cargo")
    patch.setattr(subprocess, "Popen", lambda command, **_: asked.append(command) or failed)
    for options in ([], ["--out", str(world.folder / "p")]):
        patch.setattr(sys, "argv", ["get_pbrt.py", *options])
        with pytest.raises(LightdomeError, match="cargo did not install"):
            found.main()
    assert [command[command.index("--root") + 1] for command in asked] == [
        str(cache_folder("pbrt")),
        str(world.folder / "p"),
    ]


# Those that render until an error or a time, or measure.
SLOW = {("part4_pbrt", "--error"), ("part4_pbrt", "--time"), ("part4_pbrt", "--auto"), ("bench", "--explain")}
assert set(CASES) >= SLOW


@pytest.mark.parametrize(
    "case",
    [pytest.param(case, id=" ".join(case), marks=[pytest.mark.slow] * (case in SLOW)) for case in CASES],
)
def test_an_option_does_what_it_says(world: World, monkeypatch: pytest.MonkeyPatch, case: tuple[str, str]) -> None:
    CASES[case](world, monkeypatch)
