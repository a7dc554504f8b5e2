"""The stability table: its cases hold, its measures are right, and broken samplers fail."""

from __future__ import annotations

import argparse
import csv
import json
import math
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import Script, fails_in_one_line, stiff_radiance
from lightdome import reference
from lightdome.checks import made
from lightdome.commands import stability as stability_command
from lightdome.disc import disc_mask
from lightdome.errors import LightdomeError
from lightdome.evaluation import mitsuba_process, peer_mitsuba_distribution, peers, stability, stability_cases
from lightdome.evaluation.stability import COLUMNS, Case, Figures, Lightdome, Result, Truth, measure_sampler
from lightdome.evaluation.stability_plot import colour
from lightdome.float_range import LARGEST
from lightdome.lighting.exact import exact
from lightdome.lighting.harmonics import project, shade_harmonics
from lightdome.lighting.median_cut import median_cut
from lightdome.lighting.shade import shade, shade_samples
from lightdome.maps.envmap import EnvironmentMap
from lightdome.opencl import memory
from lightdome.opencl.device import Device
from lightdome.rendering.per_pixel import ESTIMATORS, render
from lightdome.sampling.distribution import build_distribution
from lightdome.sampling.samples import Samples

DRAWS = 50_000
BY_NAME = {case.name: case for case in stability_cases.CASES}

R = 9


def test_dim_pixels_keep_their_digits_under_a_huge_one_at_the_pole(device: Device) -> None:
    # sin(theta) reduces the huge pixel so much that probabilities of pixels 2^137 below it are normal numbers.
    radiance = np.full((8192, 2, 3), 2.0**-9 * 1.37, np.float32)
    radiance[0, 0] = 2.0**127
    distribution = build_distribution(device, EnvironmentMap(radiance))
    even = memory.upload(device, np.arange(1, 8193, dtype=np.uint32))
    equator = replace(distribution, cdf=replace(distribution.cdf, marginal=even)).sample_at(np.array([[0.5, 0.5]]))
    assert equator.pixel[0, 1] == 4096
    expected = reference.probability(radiance)[4096, 1]
    assert expected > np.finfo(np.float32).tiny
    np.testing.assert_allclose(equator.probability, expected, rtol=2e-6)


@pytest.mark.parametrize("value", [2.0**-149, 2.0**-140, 1e38, LARGEST])
def test_images_end_at_the_ends_of_float32(device: Device, value: float) -> None:
    envmap = EnvironmentMap(np.full((16, 32, 3), value, np.float32))
    distribution = build_distribution(device, envmap)
    mask = disc_mask(R)
    lights = median_cut(distribution, 1)
    images = {
        "exact": exact(device, envmap, R),
        "one sample": shade_samples(device, distribution.sample(1), R),
        "samples": shade_samples(device, distribution.sample(256), R),
        "one light": shade(device, lights.direction, lights.flux, R),
        "harmonics": shade_harmonics(device, project(device, envmap), R),
    }
    for estimator in ESTIMATORS:
        ((_, images[estimator]),) = render(distribution, [16], R, estimator=estimator)
    for name, image in images.items():
        assert np.isfinite(image).all(), name
        assert image[~mask].max() == 0, name
    expected = np.minimum(reference.exact(envmap.radiance, reference.normals(R)[mask]), LARGEST)
    np.testing.assert_allclose(images["exact"][mask], expected, rtol=1e-5, atol=2.0**-149)
    np.testing.assert_allclose(images["harmonics"][mask], expected, rtol=0.01, atol=2.0**-149)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("a pixel 1e20 times brighter, 9 places", marks=pytest.mark.slow),
        "two suns, 1e10 apart in strength",
        "80 orders of magnitude, column to column",
        "80 orders of magnitude, row to row",
        "log-normal noise, sigma 8",
        pytest.param("a single lit pixel, 9 places", marks=pytest.mark.slow),
        "zero rows between lit ones",
        "everything zero",
        "subnormal pixels",
        "pixels near the maximum",
        pytest.param("both in one map", marks=pytest.mark.slow),
        "the maximum at the pole of 8192 rows",
        "1 x 1, 1 x W, H x 1",
        "luminance zero with a colour, NaN, infinity",
        "edges of CDFs: 80 orders of magnitude",
        "albedo 0, 1, 1.5, 1e6",
        "light exactly at the rim",
        "light exactly behind",
        pytest.param("white furnace", marks=pytest.mark.slow),
        "one sun of 1e20: samples are the image",
        "eta 1 - 1e-7, 1, 1 + 1e-7",
    ],
)
def test_a_case_holds(device: Device, name: str) -> None:
    result = stability.run(BY_NAME[name], device, DRAWS)
    assert result.verdict == "holds", result.remark
    assert result.figures


def test_names_are_of_one_case_each() -> None:
    assert len(BY_NAME) == len(stability_cases.CASES)


def test_the_truth_is_the_reference() -> None:
    radiance = stiff_radiance(21, 43)
    truth = Truth(radiance)
    np.testing.assert_allclose(truth.probability(slice(0, 21)), reference.probability(radiance), rtol=1e-13)
    assert truth.flux == pytest.approx(reference.flux(radiance), rel=1e-13)
    samples = Samples(
        direction=reference.directions(21, 43)[[5, 7], [9, 11]].astype(np.float32),
        radiance=radiance[[5, 7], [9, 11]],
        probability=reference.probability(radiance)[[5, 7], [9, 11]].astype(np.float32),
        pixel=np.array([[9, 5], [11, 7]], np.int32),
        map_shape=(21, 43),
    )
    np.testing.assert_allclose(truth.probability_of(samples), samples.probability, rtol=1e-7)
    normals = reference.normals(R)[disc_mask(R)]
    expected = reference.shade(normals, samples.direction, samples.radiance, samples.density)
    np.testing.assert_allclose(truth.image(samples, normals), expected, atol=1e-6 * expected.max())


class Broken(Lightdome):
    """A sampler with one defect: ``spoil`` changes its p, or the samples that it draws."""

    def __init__(
        self,
        device: Device,
        envmap: EnvironmentMap,
        p: Callable[[np.ndarray], np.ndarray] = lambda p: p,
        samples: Callable[[Samples], Samples] = lambda samples: samples,
        image: Callable[[np.ndarray], np.ndarray] = lambda image: image,
    ) -> None:
        super().__init__(build_distribution(device, envmap))
        self._p, self._samples, self._image = p, samples, image

    def probability(self, rows: slice) -> np.ndarray:
        return self._p(super().probability(rows))

    def draw(self, count: int, seed: int) -> Samples:
        return self._samples(super().draw(count, seed))

    def image(self, samples: Samples, resolution: int) -> np.ndarray:
        return self._image(super().image(samples, resolution))


def by_differences(p: np.ndarray) -> np.ndarray:
    """p as the difference of two entries of a float32 CDF."""
    return np.diff(np.cumsum(p, axis=1, dtype=np.float32), prepend=np.float32(0), axis=1)


def one_wrong(p: np.ndarray) -> np.ndarray:
    p = p.copy()
    p[7, 9] *= np.float32(1 + 5e-6)
    return p


def one_nan(p: np.ndarray) -> np.ndarray:
    p = p.copy()
    p[7, 9] = np.nan
    return p


def shifted(samples: Samples) -> Samples:
    """The pixels one to the right, with the values of those pixels."""
    pixel = (samples.pixel + np.array([1, 0])) % samples.map_shape[::-1]
    radiance = stiff_radiance(21, 43)
    x, y = pixel.T
    p = reference.probability(radiance)[y, x]
    wrong = {"pixel": pixel, "radiance": radiance[y, x], "probability": p.astype(np.float32)}
    return made(Samples, **{**vars(samples), **wrong})


@pytest.mark.parametrize(
    ("defect", "missed"),
    [
        ({}, set()),
        ({"p": by_differences}, {"p"}),
        ({"p": one_wrong}, {"p"}),
        ({"p": one_nan}, {"p", "sum", "nonfinite"}),
        ({"p": lambda p: p * np.float32(1.00001)}, {"p", "sum"}),
        ({"p": lambda p: p + np.float32(3e-45)}, {"tiny"}),
        ({"samples": shifted}, {"zero", "chi2"}),
        ({"image": lambda image: image * np.float32(1.00002)}, {"image"}),
        ({"image": lambda image: image / np.float32(0)}, {"image", "nonfinite"}),
    ],
)
@pytest.mark.filterwarnings("ignore:divide by zero|invalid value")
def test_a_defect_fails_the_columns_that_it_concerns(
    device: Device, stiff: EnvironmentMap, defect: dict[str, object], missed: set[str]
) -> None:
    figures = measure_sampler(Broken(device, stiff, **defect), Truth(stiff.radiance), DRAWS)
    assert missed <= set(Result("broken", "", "", figures).failures)
    assert missed or not Result("broken", "", "", figures).failures


@pytest.mark.parametrize("sequence", ["stratified", "sobol", "r2"])
def test_draws_too_even_for_chance_fail(device: Device, stiff: EnvironmentMap, sequence: str) -> None:
    class Even(Lightdome):
        def draw(self, count: int, seed: int) -> Samples:
            return self.distribution.sample(count, seed, sequence)

    figures = measure_sampler(Even(build_distribution(device, stiff)), Truth(stiff.radiance), DRAWS)
    assert Result("even", "", "", figures).failures == ["chi2"]


def test_each_million_draws_has_a_seed_of_its_own(device: Device) -> None:
    asked: list[tuple[int, int]] = []

    class Noted(Lightdome):
        def draw(self, count: int, seed: int) -> Samples:
            asked.append((count, seed))
            return super().draw(count, seed)

    radiance = np.ones((1, 2, 3), np.float32)
    measure_sampler(
        Noted(build_distribution(device, EnvironmentMap(radiance))), Truth(radiance), 2 * stability.BLOCK + 3
    )
    assert [count for count, _ in asked] == [stability.BLOCK, stability.BLOCK, 3]
    assert len({seed for _, seed in asked}) == 3


def test_pixels_outside_the_disc_are_not_a_peers_fault(device: Device, stiff: EnvironmentMap) -> None:
    def filled(image: np.ndarray) -> np.ndarray:
        return np.where(disc_mask(len(image))[..., None], image, 1)

    def peer(radiance: np.ndarray) -> Broken:
        return Broken(device, EnvironmentMap(radiance), image=filled)

    own = measure_sampler(peer(stiff.radiance), Truth(stiff.radiance), 1000)
    assert Result("lightdome", "", "", own).failures == ["wrong"]
    case = Case("a map", "none", lambda *_: [], maps=lambda: [stiff.radiance])
    result = stability.run_peer(case, "peer", peer, 1000)
    assert result.figures.keys() == own.keys() - {"wrong"}
    assert not result.failures


def test_a_wrong_flux_fails(device: Device, stiff: EnvironmentMap) -> None:
    sampler = Lightdome(build_distribution(device, stiff))
    sampler.flux *= 1 + 3e-6
    assert Result("broken", "", "", measure_sampler(sampler, Truth(stiff.radiance), DRAWS)).failures == ["flux"]


@pytest.mark.parametrize(("change", "missed"), [(0, []), (-(2**23), ["cdf", "drawn"]), (2**18, ["drawn"])])
def test_a_damaged_cdf_of_a_row_fails(device: Device, stiff: EnvironmentMap, change: int, missed: list[str]) -> None:
    distribution = build_distribution(device, stiff)
    cdf = memory.download(device, distribution.cdf.rows).astype(np.int64)
    lit = np.flatnonzero(stiff.radiance[4].any(axis=1))
    cdf[4, lit[3]] += change
    damaged = replace(distribution, cdf=replace(distribution.cdf, rows=memory.upload(device, cdf.astype(np.uint32))))
    figures = stability.cdf_figures(damaged, Truth(stiff.radiance))
    assert Result("broken", "", "", figures).failures == missed


def test_a_step_of_a_black_row_fails(device: Device, stiff: EnvironmentMap) -> None:
    distribution = build_distribution(device, stiff)
    cdf = memory.download(device, distribution.cdf.marginal).copy()
    cdf[:, 1:] += np.uint32(1)  # row 1 is black
    damaged = replace(distribution, cdf=replace(distribution.cdf, marginal=memory.upload(device, cdf)))
    assert Result("broken", "", "", stability.cdf_figures(damaged, Truth(stiff.radiance))).failures == ["cdf"]


def test_chi_square_tells_chance_from_defect() -> None:
    rng = np.random.default_rng(1)
    p = rng.dirichlet(np.ones(500))
    z = [stability.chi_square_z(rng.multinomial(100_000, p), p) for _ in range(200)]
    assert abs(np.mean(z)) < 0.3
    assert np.std(z) == pytest.approx(1, abs=0.2)
    assert stability.chi_square_z(rng.multinomial(100_000, rng.dirichlet(np.ones(500))), p) > 100
    assert stability.chi_square_z(np.array([9, 1]), np.array([1.0, 0.0])) == math.inf
    assert stability.chi_square_z(np.array([9, 0]), np.array([1.0, 0.0])) is None


def test_a_verdict_needs_every_goal_and_nan_misses_any() -> None:
    good = {name: column.goal for name, column in COLUMNS.items()}
    assert Result("x", "g", "c", good).verdict == "holds"
    for name in COLUMNS:
        for bad in (COLUMNS[name].goal * 1.01 + 1e-30, math.nan, math.inf):
            result = Result("x", "g", "c", good | {name: bad})
            assert result.failures == [name]
            assert result.verdict == "FAILS"
            assert f"off: {name}" in result.remark
            assert replace(result, judged=False).verdict == "measured"


def test_limits_are_mentioned_where_they_bind() -> None:
    remark = Result("x", "g", "c", {"tiny": 0.5, "subnormal": 7, "undrawn": 3, "undrawn_flux": 1e-9}).remark
    assert "7 pixels with p < 2^-126 are exact only to 2^-149" in remark
    assert "3 lit pixels, 1e-09 of the flux" in remark
    assert "exact only to 2^-149" not in Result("x", "g", "c", {"tiny": 5, "subnormal": 7}).remark


def test_colours_are_light_where_a_goal_holds_and_dark_where_not() -> None:
    grey = [colour(value, 1e-6).sum() for value in (0.0, 1e-9, 1e-7, 1e-6, 1.1e-6, 1e-3, 1.0, math.nan)]
    assert grey == sorted(grey, reverse=True)
    assert grey[3] > grey[4] + 0.5
    assert colour(1, 0).sum() == grey[-1]


# ---- the script ----


# One holds, one also has maps, one does not fit in memory, and one is left out of a quick run.
SMALL_CASES = [
    BY_NAME["light exactly behind"],
    BY_NAME["odd sizes"],
    replace(BY_NAME["4096 x 2048, log-normal"], needs=2**62, large=False),
    BY_NAME["resolution 4096"],
]


def run_table(cases: list[Case], *peers: str, out: Path) -> None:
    stability_command.run(argparse.Namespace(quick=True, peers=list(peers), device=None, out=out), cases, draws=1000)


@pytest.mark.slow
def test_the_script_writes_what_it_measured(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(mitsuba_process, "find_spec", lambda name: None)
    run_table(SMALL_CASES, "mitsuba", out=tmp_path)
    printed = capsys.readouterr().out
    assert "2 cases hold, 0 fail, 1 skipped" in printed
    assert f"peer mitsuba: absent ({peers.INSTALL})" in printed
    with (tmp_path / "stability.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [r["verdict"] for r in rows] == ["holds", "holds", "skipped"]
    assert rows[0]["p"] == ""
    assert 0 < float(rows[1]["p"]) < 2e-6
    assert "GiB" in rows[2]["remark"]
    data = json.loads((tmp_path / "stability.json").read_text())
    assert [case["figures"].get("p", "") for case in data["cases"][:2]] == ["", float(rows[1]["p"])]
    assert data["options"]["draws"] == 1000
    assert data["columns"]["p"]["goal"] == 2e-6
    assert data["device"]
    assert {p.name for p in tmp_path.iterdir()} == {f"stability.{s}" for s in ("csv", "json", "png")}


@pytest.mark.slow
def test_a_case_that_fails_fails_the_script(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def check(device: Device, draws: int) -> list[Figures]:
        return [{"p": 1e-7}, {"p": math.nan}, {"p": 1e-6}]

    with pytest.raises(LightdomeError, match="1 of 2 cases fail"):
        run_table([SMALL_CASES[0], Case("hopeless", "none", check)], out=tmp_path)
    assert "FAILS    lightdome  none: hopeless (off: p nan)" in capsys.readouterr().out
    assert '"p": "nan"' in (tmp_path / "stability.json").read_text()


def test_an_unknown_device_gives_one_line(script: Script, tmp_path: Path) -> None:
    fails_in_one_line(script("stability", "--quick", "--device", "magic", "--out", tmp_path), "magic")


# ---- Mitsuba ----


@contextmanager
def started() -> Iterator[peer_mitsuba_distribution.MitsubaSamplers]:
    if not mitsuba_process.installed():
        pytest.skip(f"needs Mitsuba: {peers.INSTALL}")
    with ExitStack() as stack:
        try:
            process = stack.enter_context(peer_mitsuba_distribution.start())
        except LightdomeError as error:
            if "needs LLVM" not in str(error):
                raise
            pytest.skip(str(error))
        yield process


@pytest.fixture(scope="module")
def mitsuba() -> Iterator[peer_mitsuba_distribution.MitsubaSamplers]:
    with started() as process:
        yield process


@pytest.mark.peer
def test_mitsuba_is_right_where_the_map_is_mild(mitsuba: peer_mitsuba_distribution.MitsubaSamplers) -> None:
    radiance = np.random.default_rng(3).uniform(1, 2, (9, 14, 3)).astype(np.float32)
    figures = measure_sampler(mitsuba.sampler(radiance), Truth(radiance), DRAWS)
    assert figures["p"] < 1e-4
    assert max(figures["sum"], figures["flux"]) < 1e-6
    assert figures["image"] < 1e-4
    assert figures["chi2"] < 5
    assert figures["zero"] == figures["nonfinite"] == 0


@pytest.mark.peer
def test_mitsuba_is_measured_not_judged(mitsuba: peer_mitsuba_distribution.MitsubaSamplers) -> None:
    result = stability.run_peer(BY_NAME["log-normal noise, sigma 8"], "mitsuba", mitsuba.sampler, DRAWS)
    assert result.verdict == "measured"
    assert "p" in result.failures


@pytest.mark.peer
def test_a_crash_of_mitsuba_costs_only_its_column() -> None:
    others = set(multiprocessing.active_children())
    with started() as process:
        (child,) = set(multiprocessing.active_children()) - others
        os.kill(child.pid, signal.SIGABRT)
        for _ in range(2):
            result = stability.run_peer(BY_NAME["odd sizes"], "mitsuba", process.sampler, DRAWS)
            assert result.verdict == "skipped"
            assert "Mitsuba's process" in result.remark
