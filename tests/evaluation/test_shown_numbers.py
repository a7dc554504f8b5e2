"""Every number that a plot or a table shows is the number that was measured, in the unit that its label states.

Figures and tables are made from measurements with distinct values and read back: lines, bars, labels, legends, cells.
Each number read is multiplied by the unit in its label, and compared with the definition.
"""

from __future__ import annotations

import csv
import json
import math
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from types import SimpleNamespace

import matplotlib.colors
import numpy as np
import pyopencl as cl
import pytest
from helpers import module_of, stiff_radiance
from lightdome import reference
from lightdome.disc import disc_mask
from lightdome.evaluation import (
    benchmark,
    benchmark_plot,
    report,
    report_figures,
    roofline,
    roofline_plot,
    stability,
    stability_plot,
)
from lightdome.evaluation.benchmark import MethodMeasurement
from lightdome.evaluation.benchmark_plot import ERROR, RUN_TIME
from lightdome.evaluation.roofline import Limits, Timing
from lightdome.evaluation.roofline_stages import MADE, Stage, Work
from lightdome.evaluation.stability import COLUMNS, LIMITS, Result
from lightdome.fresnel import plot
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.images import auto_exposure, tone_map, write_image
from lightdome.names import ESTIMATORS, PIXEL_SEQUENCES, SEQUENCES, per_pixel
from lightdome.opencl.device import Device
from lightdome.opencl.profile import Profile
from lightdome.opencl.programs import Programs
from lightdome.sampling.distribution import build_distribution
from lightdome.sampling.samples import Samples
from matplotlib.axes import Axes
from matplotlib.figure import Figure

UNITS = {
    "%": 1e-2,
    "ms": 1e-3,
    "milliseconds": 1e-3,
    "us": 1e-6,
    "s": 1.0,
    "MiB": 2.0**20,
    "GB/s": 1e9,
    "G/s": 1e9,
    "degrees": np.pi / 180,
}


def unit(label: str) -> float:
    """The factor for numbers with this ``label``: the single unit that the label names, or 1."""
    named = {word for word in re.split(r"[\s,()]+", label) if word in UNITS}
    assert len(named) < 2, label
    return UNITS[named.pop()] if named else 1.0


def close(shown: str | float, value: float, digits: int = 3) -> bool:
    """Whether ``shown`` equals ``value`` to this many digits."""
    return float(shown) == pytest.approx(value, rel=0.6 * 10.0 ** (1 - digits), abs=1e-12)


def rounded(shown: str, value: float) -> bool:
    """Whether the decimal text ``shown`` is ``value`` to its last place."""
    places = len(shown.partition(".")[2])
    return float(shown) == pytest.approx(value, abs=0.501 * 10.0**-places)


def lines(axes: Axes) -> dict[str, np.ndarray]:
    """The lines that have a label, (n, 2), in the units of the axes' labels."""
    units = unit(axes.get_xlabel()), unit(axes.get_ylabel())
    named = {line.get_label(): np.array(line.get_data(), float).T for line in axes.lines}
    return {name: data * units for name, data in named.items() if not name.startswith("_")}


def legend(axes: Axes) -> list[str]:
    return [entry.get_text() for entry in axes.get_legend().get_texts()]


# ---- the benchmark ----


def measured(method: str, count: int, kind: str, *, peer: bool = False, rmse: float | None = None) -> MethodMeasurement:
    """A measurement whose numbers are all different, and different from those of any other."""
    of_it = np.random.default_rng([count, *method.encode()])
    wall, error, spread, largest, bias, around, first = of_it.uniform(0.2, 0.9, 7)
    stages = {"row cdf": 0.31 * wall, "shade": 0.17 * wall, method: 0.11 * wall}
    return MethodMeasurement(
        method=method,
        kind=kind,
        count=count,
        seeds=3 + count % 5,
        rmse=0.3 * error if rmse is None else rmse,
        rmse_spread=0.04 * spread,
        largest_error=1.7 * largest,
        bias=(-0.02 if count % 3 else 0.02) * bias,
        wall_seconds=0.06 * wall / count**0.1,
        wall_spread=0.004 * around,
        first_seconds=3 * first,
        pixels="areas" if method == "mis" else "centres",
        peer=peer,
        stages={name: 0.06 / count**0.1 * seconds for name, seconds in stages.items()},
    )


POINTS = [
    *(measured("independent", n, "shared") for n in (16, 64, 256)),
    *(measured("light", n, "per pixel") for n in (8, 32, 128)),
    *(measured("mis", n, "per pixel") for n in (8, 32)),
    measured("harmonics", 2, "order"),
    *(measured("pbrt", n, "per pixel", peer=True) for n in (8, 64)),
    # At each level of error, the fastest is not the most accurate.
    *(
        replace(measured("sobol", n, "shared"), rmse=0.55 / n, wall_seconds=0.01 + 1e-5 * n, stages={"shade": 2e-5 * n})
        for n in (16, 64, 128)
    ),
    measured("exact", 1, "order", rmse=3e-9),
]
INEXACT = [p for p in POINTS if p.method != "exact"]
KINDS = {
    **dict.fromkeys((*SEQUENCES, "median-cut"), "shared"),
    **{per_pixel(e, sequence): "per pixel" for e in ESTIMATORS for sequence in PIXEL_SEQUENCES},
    "mis-compensated-sobol": "per pixel",
    "harmonics": "order",
}
PANELS = ["shared by all pixels", *(f"per pixel: {e}" for e in ESTIMATORS), "other programs"]
OF_METHOD = {name: [p for p in INEXACT if p.method == name] for name in dict.fromkeys(p.method for p in INEXACT)}


def fastest(points: Sequence[MethodMeasurement], error: float) -> MethodMeasurement | None:
    """The fastest measurement with at most ``error``."""
    return next((p for p in sorted(points, key=lambda p: p.wall_seconds) if p.rmse <= error), None)


def test_the_headline_has_one_line_for_each_group_named_at_its_end() -> None:
    (axes,) = benchmark_plot.error_against_time(POINTS, "a title").axes
    assert "run time" in axes.get_xlabel()
    assert "RMSE" in axes.get_ylabel()
    assert (axes.get_xscale(), axes.get_yscale(), axes.get_title(loc="left")) == ("log", "log", "a title")
    assert axes.get_legend() is None
    found = lines(axes)
    (exact, _) = found.pop("exact")
    assert exact[0] == pytest.approx(POINTS[-1].wall_seconds)
    kinds = (("independent", "sobol"), ("light", "mis"), ("harmonics",), ("pbrt",))
    said = [text.get_text() for text in axes.texts]
    for names in kinds:
        # Squared error times time: what a variance costs.
        best = min((p for name in names for p in OF_METHOD[name]), key=lambda p: p.rmse**2 * p.wall_seconds).method
        np.testing.assert_allclose(found.pop(best), [(p.wall_seconds, p.rmse) for p in OF_METHOD[best]])
        last = OF_METHOD[best][-1]
        counted = {"per pixel": f"{last.count} spp", "order": f"order {last.count}", "shared": f"{last.count} lights"}
        (end,) = (text for text in said if text.endswith(f"{best}, {counted[last.kind]}"))
        assert end
    assert not found


def test_the_headline_has_at_most_seven_lines_whatever_was_measured() -> None:
    own = [measured(name, n, kind) for name, kind in KINDS.items() for n in (8, 64)]
    names = ("numpy", "mitsuba scalar_rgb", "mitsuba llvm_ad_rgb", "pbrt-v3", "pbrt-v4", "pbrt-v4 /elsewhere")
    peers = [measured(name, n, "per pixel", peer=True) for name in names for n in (8, 64)]
    (axes,) = benchmark_plot.error_against_time(own + peers, "").axes
    assert len(axes.lines) == 7
    assert len({(line.get_color(), line.get_marker()) for line in axes.lines}) == 7
    figure = benchmark_plot.error_against_time_all(own + peers, "")
    assert [axes.get_title(loc="left") for axes in figure.axes] == PANELS
    for panel in figure.axes:
        named = [line for line in panel.lines if line.get_label()[0] != "_"]
        assert [line.get_label() for line in named] == legend(panel)
        assert len({(line.get_color(), line.get_marker()) for line in named}) == len(named) <= 7


def test_error_against_time_of_all_has_milliseconds_and_percent() -> None:
    figure = benchmark_plot.error_against_time_all(POINTS, "a title")
    front = [
        p
        for p in INEXACT
        if not any(q.rmse <= p.rmse and q.wall_seconds <= p.wall_seconds for q in INEXACT if q is not p)
    ]
    front.sort(key=lambda p: p.wall_seconds)
    remaining = dict(OF_METHOD)
    for axes in figure.axes:
        units = unit(RUN_TIME), unit(ERROR)
        places = {tuple(np.round(np.multiply(text.xy, units), 9)): text.get_text() for text in axes.texts}
        for line in axes.lines:
            line.axes.set(xlabel=RUN_TIME, ylabel=ERROR)  # of common axes, only the outer ones say it
        own = [line for line in axes.lines if line.get_label()[0] != "_"]
        for line in own:
            points = remaining.pop(line.get_label())
            np.testing.assert_allclose(lines(axes)[line.get_label()], [(p.wall_seconds, p.rmse) for p in points])
            for p in {points[0].count: points[0], points[-1].count: points[-1]}.values():
                assert places.pop((round(p.wall_seconds, 9), round(p.rmse, 9))) == str(p.count)
        assert not places
        (joined,) = (line for line in axes.lines if line.get_label() == "_Pareto front")
        np.testing.assert_allclose(
            np.array(joined.get_data(), float).T * units, [(p.wall_seconds, p.rmse) for p in front]
        )
    assert not remaining
    _, said = (text.get_text() for text in figure.legends[0].get_texts())
    method, seconds = said.split(", ")
    assert method == "exact"
    assert close(seconds.removesuffix(" s"), POINTS[-1].wall_seconds, 2)


def test_read_outs_beside_error_against_time_are_the_best_there_are() -> None:
    text = benchmark_plot.error_against_time_all(POINTS, "").legends[0].get_title().get_text()
    by_error, by_time = text.split("most exact at equal time")
    rows = re.findall(r"^ *([\d.]+) %  (.*)$", by_error, re.MULTILINE)
    assert [row[0] for row in rows] == ["10.0", "3.0", "1.0", "0.3"]
    for percent, found in rows:
        best = fastest(INEXACT, float(percent) / 100)
        if best is None:
            assert found == "none measured"
            continue
        name, shown = found.rsplit(", ", 1)
        assert name == f"{best.method} {best.count}"
        assert rounded(shown.removesuffix(" ms"), 1e3 * best.wall_seconds)
    rows = re.findall(r"^ *(\d+) ms (.*)$", by_time, re.MULTILINE)
    assert [row[0] for row in rows] == ["10", "30", "100", "1000"]
    assert {found == "none measured" for _, found in rows} == {True, False}
    for milliseconds, found in rows:
        within = [p for p in INEXACT if p.wall_seconds <= float(milliseconds) / 1000]
        if not within:
            assert found == "none measured"
            continue
        best = sorted(within, key=lambda p: p.rmse)[0]
        name, shown = found.rsplit(", ", 1)
        assert name == f"{best.method} {best.count}"
        assert rounded(shown.removesuffix(" %"), 100 * best.rmse)


def test_error_against_count_has_spreads_in_percent_and_slopes() -> None:
    figure = benchmark_plot.error_against_count(POINTS, "a title")
    remaining = {name: points for name, points in OF_METHOD.items() if len(points) > 1}
    assert "count" in figure.axes[-1].get_xlabel()
    assert "RMSE" in figure.axes[0].get_ylabel()
    percent = unit(figure.axes[0].get_ylabel())
    assert percent == 0.01
    for axes in figure.axes:
        assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
        for container in axes.containers:
            line, _, (bars,) = container
            method, slope = container.get_label().split(", slope ")
            points = remaining.pop(method)
            counts, errors = np.array([(p.count, p.rmse) for p in points]).T
            np.testing.assert_allclose(np.array(line.get_data(), float), (counts, errors / percent))
            x, y = np.log(counts) - np.log(counts).mean(), np.log(errors)
            assert rounded(slope, (x * y).sum() / (x * x).sum())
            for p, ((x0, low), (x1, high)) in zip(points, bars.get_segments(), strict=True):
                spread = min(p.rmse_spread, 0.9 * p.rmse)
                assert (x0, x1) == (p.count, p.count)
                assert (low * percent, high * percent) == pytest.approx((p.rmse - spread, p.rmse + spread))
    assert not remaining


def test_stages_are_shares_of_the_wall_time() -> None:
    names = [f"stage {k}" for k in range(9)]
    points = [
        replace(
            measured(f"method {k}", n, "shared"),
            stages={name: (i % 5 + i // 5 / 2 + 1) / 40 * 2e-3 for i, name in enumerate(names)},
            wall_seconds=2e-3,
        )
        for k in range(3)
        for n in (4, 16, 64)
    ]
    points.append(replace(measured("bare", 1, "order"), wall_seconds=3e-3, stages={"stage 8": 1e-3}))
    figure = benchmark_plot.stages(points, "a title")
    (axes,) = figure.axes
    assert axes.get_xlabel() == "share of the wall time"
    shown = [p for p in points if p.count != 16]  # the least and the largest count of each
    rows = [label.get_text() for label in axes.get_yticklabels()]
    for row, p in zip(rows, shown, strict=True):
        name, milliseconds = re.fullmatch(r"(.*) \(([\d.]+) ms\)", row).groups()
        assert name == f"{p.method} {p.count}"
        assert rounded(milliseconds, 1e3 * p.wall_seconds)
    bars = {container.get_label(): list(container) for container in axes.containers}
    most = [f"stage {k}" for k in (2, 3, 4, 6, 7, 8)]
    assert list(bars) == [*most, "other stages", "host"]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == list(bars)
    for y, p in enumerate(shown):
        shares = {name: seconds / p.wall_seconds for name, seconds in p.stages.items()}
        shares["host"] = 1 - sum(shares.values())
        shares["other stages"] = sum(shares.get(f"stage {k}", 0) for k in (0, 1, 5))
        left = 0.0
        for name, of_stage in bars.items():
            bar = of_stage[y]
            assert bar.get_width() == pytest.approx(shares.get(name, 0))
            assert bar.get_x() == pytest.approx(left)
            assert bar.get_y() + bar.get_height() / 2 == pytest.approx(y)
            left += bar.get_width()
        assert left == pytest.approx(1)


def spheres(count: int, side: int = 40) -> list[np.ndarray]:
    """Images of a sphere, all different, black outside the disc."""
    rng = np.random.default_rng(3)
    mask = disc_mask(side)[..., None]
    truth = rng.uniform(1, 2, (side, side, 3))
    return [
        (mask * (truth + (0.05 + 0.04 * i) * rng.normal(1 + i, 1, truth.shape))).astype(np.float32)
        for i in range(count)
    ]


def rmse(image: np.ndarray, exact: np.ndarray) -> float:
    mask = disc_mask(len(exact))
    difference = image[mask].astype(np.float64) - exact[mask]
    return math.sqrt(np.square(difference).sum() / np.square(exact[mask].astype(np.float64)).sum())


def test_images_stand_over_their_own_errors() -> None:
    exact, other, first, second = spheres(4)
    figure = benchmark_plot.images({"first": first, "second": second}, exact, "a title", {"second": other})
    cells = [axes for axes in figure.axes if axes.images]
    pictures = {axes.get_title(): axes for axes in cells}
    mask = disc_mask(len(exact))
    exposure = auto_exposure(exact)
    for name, image in (("exact", exact), ("first", first), ("second", second)):
        shown = np.array(pictures[name].images[0].get_array())
        np.testing.assert_array_equal(shown[mask], tone_map(image, exposure)[mask])
        assert (shown[~mask] == 255).all()
    errors = [axes for axes in cells if axes.get_title().endswith(" %")]
    for axes, image, own in zip(errors, (first, second), (exact, other), strict=True):
        assert rounded(axes.get_title().removesuffix(" %"), 100 * rmse(image, own))
        largest = np.abs(image - own).max(axis=2) / exact.max()
        shown = axes.images[0].get_array()
        np.testing.assert_allclose(shown.filled(np.nan)[mask], np.maximum(largest, 1e-4)[mask], rtol=1e-6)
        assert (shown.mask | np.isnan(shown.data))[~mask].all()
        assert (axes.images[0].norm.vmin, axes.images[0].norm.vmax) == (1e-4, 1)
    assert [axes.get_xlabel() for axes in figure.axes if axes.get_label() == "<colorbar>"] == [
        "largest channel's error / image maximum"
    ]


def plain(value: object) -> str:
    """The value as a CSV file shows it."""
    return "" if value is None else str(value)


def test_the_benchmark_s_files_hold_every_figure(tmp_path: Path) -> None:
    benchmark.write_method_csv(tmp_path / "bench.csv", POINTS)
    benchmark.write_method_json(tmp_path / "bench.json", POINTS, {"machine": "here"})
    data = json.loads((tmp_path / "bench.json").read_text())
    assert data == {"machine": "here", "measurements": [asdict(p) for p in POINTS]}
    with (tmp_path / "bench.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    for row, p in zip(rows, POINTS, strict=True):
        expected = {name: plain(value) for name, value in asdict(p).items() if name != "stages"}
        found = {name: row.pop(name) for name in expected}
        assert found == expected
        assert {name: float(value) for name, value in row.items() if value} == {
            f"stage {name}": seconds for name, seconds in p.stages.items()
        }


@pytest.mark.slow
def test_the_benchmark_s_script_prints_what_it_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], drawn: dict[str, Figure]
) -> None:
    write_image(tmp_path / "map.pfm", stiff_radiance(8, 16))
    options = ["--methods", "independent", "light", "--counts", "16", "64", "--spp", "8", "2", "--resolution", "9"]
    options += ["--seeds", "5", "--repeats", "2", "--map", str(tmp_path / "map.pfm"), "--out", str(tmp_path / "out")]
    monkeypatch.setattr(sys, "argv", ["bench.py", *options])
    module_of("bench").main()
    written = json.loads((tmp_path / "out" / "bench.json").read_text())["measurements"]
    points = [MethodMeasurement(**measurement) for measurement in written]
    asked = [("independent", 16), ("independent", 64), ("light", 2), ("light", 8)]
    assert [(p.method, p.count, p.seeds) for p in points] == [(*each, 5) for each in asked]

    printed = capsys.readouterr().out.splitlines()
    start = next(i for i, line in enumerate(printed) if line.startswith("method "))
    assert re.split(r"\s{2,}", printed[start]) == ["method", "count", "RMSE %", "spread", "bias %", "ms"]
    for line, p in zip(printed[start + 1 : start + 1 + len(points)], points, strict=True):
        method, count, error, spread, bias, milliseconds = line.split()
        assert (method, int(count)) == (p.method, p.count)
        assert rounded(error, 100 * p.rmse)
        assert rounded(spread, 100 * p.rmse_spread)
        assert rounded(bias, 100 * p.bias)
        assert rounded(milliseconds, 1e3 * p.wall_seconds)
    cheapest = re.findall(r"^  for +([\d.]+) %: (.*)$", "\n".join(printed), re.MULTILINE)
    assert [percent for percent, _ in cheapest] == ["10.0", "3.0", "1.0", "0.3"]
    for percent, found in cheapest:
        best = fastest(points, float(percent) / 100)
        if best is None:
            assert found == "none"
            continue
        name, shown = found.split(", ")
        assert name == f"{best.method} {best.count}"
        assert rounded(shown.removesuffix(" ms"), 1e3 * best.wall_seconds)
    assert {
        name: figure.axes[0].get_xlabel().partition(",")[0].partition(":")[0] for name, figure in drawn.items()
    } == {
        "error_time": "run time",
        "error_time_all": "run time",
        "error_count": "count",
        "stages": "share of the wall time",
        "images": "",
    }
    assert {axes.get_title() for axes in drawn["images"].axes} >= {"exact", "independent 64", "light 8"}


# ---- the roofline ----

LIMITS_MEASURED = Limits({2**21: 61e9, 2**25: 83e9, 2**29: 17e9}, 143e9, 7.3e-6)


def timing(name: str, seconds: float, height: int, resolution: int | None, n: int | None, **more: float) -> Timing:
    skips = name.startswith("shade")
    work = Work(1.1e6 * height, 3.7e6 * height, 5.3e3 * height, "samples", 2.9e7 if skips else 0.0, skips)
    stage = Stage(name, print, work, None, MADE, (height, 2 * height), resolution, n)
    peak = more.get("peak", 1.7e6 * height)
    return Timing(stage, seconds, seconds / 7, 4, round(peak) or None, more.get("bandwidth"))


TIMINGS = [
    timing("row cdf", 0.0021, 16, None, None),
    timing("row cdf", 0.0134, 64, None, None),
    timing("row cdf", 0.0457, 128, None, None, bandwidth=23e9),
    timing("shade", 0.00031, 64, 31, 8),
    timing("shade", 0.00153, 64, 31, 64),
    timing("exact", 0.0117, 64, 31, None, peak=0),
    timing("exact", 0.0379, 64, 63, None, peak=0),
]
RATED = [roofline.rated(t, LIMITS_MEASURED) for t in TIMINGS]


def test_rates_and_shares_are_by_their_definitions() -> None:
    for t, p in zip(TIMINGS, RATED, strict=True):
        work = t.stage.work
        sizes, rates = zip(*LIMITS_MEASURED.copies.items(), strict=True)
        copied = t.bandwidth or np.interp(math.log(work.bytes), np.log(sizes), rates)
        shares = {"bandwidth": work.bytes / copied / t.seconds, "multiply-add": work.operations / 143e9 / t.seconds}
        assert (p.bandwidth_share, p.multiply_add_share) == pytest.approx(tuple(shares.values()))
        assert (p.bound, p.bound_share) == max(
            zip(shares, (p.bandwidth_share, p.multiply_add_share), strict=True), key=lambda share: share[1]
        )
        assert p.rate == pytest.approx(work.amount / t.seconds)
        assert (p.brute_force_ratio or 0) == pytest.approx(7 * work.pairs / 143e9 / t.seconds)
        copied_over = (p.stage, p.seconds, p.spread, p.repeats, p.peak_bytes, p.bytes, p.operations, p.unit)
        known = (t.stage.name, t.seconds, t.spread, t.repeats, t.peak_bytes, work.bytes, work.operations, work.unit)
        assert copied_over == known
        assert (p.map, p.height, p.width, p.resolution, p.N) == (
            MADE,
            t.stage.map_shape[0],
            t.stage.map_shape[1],
            t.stage.resolution,
            t.stage.N,
        )
        assert p.counted == ("brute force" if work.skips else "least")


class Timed(Programs):
    """Kernels that do their work, although the device reports 4 ms for each."""

    def kernel(self, name: str, **defines: int) -> Callable[..., object]:
        kernel = super().kernel(name, **defines)

        def run(queue: object, size: tuple[int, ...], local: object, /, **arguments: object) -> object:
            kernel(queue, size, local, **arguments).wait()
            times = {cl.profiling_info.START: 1_000_000, cl.profiling_info.END: 5_000_000}
            return SimpleNamespace(wait=lambda: None, command_execution_status=0, get_profiling_info=times.get)

        return run


def test_limits_are_work_over_the_time_of_its_kernels(device: Device) -> None:
    timed = replace(device, programs=Timed(device.context, FUSED=1), profile=Profile())
    copied, seconds = roofline.copy(timed, 2**16)
    assert copied.nbytes == 2**16
    assert seconds == pytest.approx(0.004)
    limits = roofline.measure_limits(timed, [2**17, 2**19])  # bytes that are read and written
    assert limits.copies == pytest.approx({size: size / 0.004 for size in (2**17, 2**19)})
    sums, seconds = roofline.multiply_add(timed, 8)
    assert seconds == pytest.approx(0.004)
    chains = 1 if device.is_gpu else roofline.CHAINS
    assert limits.multiply_adds == pytest.approx(sums.size * chains * roofline.STEPS / 0.004)
    known = Stage("known", lambda: None, Work(2**18, 1, 1, "pixels"), events=(), beside_copy=True)
    assert roofline.time_stage(timed, known, 3).bandwidth == pytest.approx(2**18 / 0.004)


def test_a_launch_is_timed_from_the_call_to_its_end(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    ticks = iter(0.125 * n for n in range(10**6))
    monkeypatch.setattr(roofline, "time", SimpleNamespace(perf_counter=lambda: next(ticks)))
    assert roofline.launch(device) == 0.125


def test_the_roof_is_that_of_the_limits() -> None:
    (axes,) = roofline_plot.roofline(RATED, LIMITS_MEASURED, "a device").axes
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    assert axes.get_xlabel() == "operations on float32 per byte"
    assert axes.get_ylabel() == "operations per second"
    assert axes.get_title(loc="left") == "a device"
    named = lines(axes)
    for size, rate in ((2**25, 83e9), (2**29, 17e9)):
        label = next(name for name in named if name.startswith(f"copy of {size // 2**20} MiB: "))
        x, y = named.pop(label).T
        np.testing.assert_allclose(y, [min(rate * i, 143e9) for i in x])
        assert close(label.split()[-2], rate / 1e9)
        assert label.endswith("GB/s")
    (label,) = [name for name in named if name.startswith("multiply-adds: ")]
    del named[label]
    assert label == "multiply-adds: 143 G/s"
    marks = [np.array(line.get_data(), float).T for line in axes.lines if line.get_label().startswith("_")]
    everywhere = sorted(tuple(place) for places in marks for place in places)
    np.testing.assert_allclose(everywhere, sorted((p.operations / p.bytes, p.operations / p.seconds) for p in RATED))
    longest = {
        name: max((p for p in RATED if p.stage == name), key=lambda p: p.seconds)
        for name in ("row cdf", "shade", "exact")
    }
    sizes = {"row cdf": "256 x 128", "shade": "128 x 64, R 31, N 64", "exact": "128 x 64, R 63"}
    for number, ((label, ((x, y),)), (name, p)) in enumerate(zip(named.items(), longest.items(), strict=True), 1):
        assert (x, y) == pytest.approx((p.operations / p.bytes, p.operations / p.seconds))
        what, share = label.split(": ")
        assert what == f"{number}  {name}, {sizes[name]}"
        if name == "shade":
            assert rounded(share.removesuffix(" x brute force"), p.operations / 143e9 / p.seconds)
        else:
            of_copy = p.bytes / (23e9 if name == "row cdf" else LIMITS_MEASURED.bandwidth(p.bytes))
            assert close(share.removesuffix(" %"), 100 * max(of_copy, p.operations / 143e9) / p.seconds)
    assert {text.get_text(): text.xy for text in axes.texts} == {
        str(number): pytest.approx((p.operations / p.bytes, p.operations / p.seconds))
        for number, p in enumerate(longest.values(), 1)
    }


def fitted(sizes: Sequence[float], values: Sequence[float]) -> float:
    x, y = np.log(sizes) - np.mean(np.log(sizes)), np.log(values)
    return float((x * y).sum() / (x * x).sum())


def test_scaling_has_milliseconds_and_mebibytes_over_sizes() -> None:
    figure = roofline_plot.scaling(RATED, "a device")
    grid = np.reshape(figure.axes, (3, 3))
    expected = {
        "pixels of the map": {"row cdf": ([2 * h * h for h in (16, 64, 128)], RATED[:3])},
        "pixels of the image": {"exact": ([31**2, 63**2], RATED[5:])},
        "N, samples or lights": {"shade": ([8, 64], RATED[3:5])},
    }
    ticks = [["32 x 16", "128 x 64", "256 x 128"], ["31 x 31", "63 x 63"], ["8", "64"]]
    for (times, memories, legends), (label, stages), named in zip(grid.T, expected.items(), ticks, strict=True):
        ((name, (sizes, points)),) = stages.items()
        for axes, word, values in (
            (times, "time", [p.seconds for p in points]),
            (memories, "memory", [p.peak_bytes for p in points if p.peak_bytes]),
        ):
            assert axes.get_xlabel() == label
            assert word in axes.get_ylabel()
            assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
            (line,) = axes.lines
            np.testing.assert_allclose(line.get_xdata(), sizes[: len(values)])
            np.testing.assert_allclose(np.asarray(line.get_ydata(), float) * unit(axes.get_ylabel()), values)
            np.testing.assert_allclose(axes.get_xticks(), sizes)
            assert [tick.get_text() for tick in axes.get_xticklabels()] == named
        assert unit(times.get_ylabel()) == 1e-3
        assert unit(memories.get_ylabel()) == 2**20
        (said,) = legend(legends)
        stage, time, memory = re.fullmatch(r"(.*): (.*), (.*)", said).groups()
        assert stage == name
        assert rounded(time, fitted(sizes, [p.seconds for p in points]))
        peaks = [p.peak_bytes for p in points if p.peak_bytes]
        assert (memory == "–") if not peaks else rounded(memory, fitted(sizes, peaks))


def test_scaling_shows_no_memory_that_the_allocator_decides() -> None:
    peaks = {16: 2**12, 64: 2**11, 128: 3 * 2**20}  # bytes; less than a page, and less for more
    timings = [timing("row cdf", 1e-3, height, None, None, peak=peak) for height, peak in peaks.items()]
    figure = roofline_plot.scaling([roofline.rated(t, LIMITS_MEASURED) for t in timings], "a device")
    _, memories, legends = np.reshape(figure.axes, (3, 3))[:, 0]
    (line,) = memories.lines
    np.testing.assert_array_equal(line.get_ydata(), [3])
    assert legend(legends) == ["row cdf: 0.00, –"]


def test_the_roofline_s_file_holds_every_figure(tmp_path: Path) -> None:
    roofline.write_stage_csv(tmp_path / "roofline.csv", RATED)
    with (tmp_path / "roofline.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert rows == [{name: plain(value) for name, value in asdict(p).items()} for p in RATED]


# ---- stability ----


def figures(case: str, names: Sequence[str], miss: str = "") -> dict[str, float]:
    """Figures that meet their goals, all different, except ``miss``."""
    shares = np.random.default_rng([*case.encode()]).uniform(0.1, 0.9, len(names))
    found = {name: COLUMNS[name].goal * share for name, share in zip(names, shares, strict=True)}
    return found | ({miss: 30 * COLUMNS[miss].goal} if miss else {})


RESULTS = [
    Result("lightdome", "ramps", "steep", figures("steep", ["p", "sum", "chi2", "flux", "image"]) | {"subnormal": 7.0}),
    Result("mitsuba", "ramps", "steep", figures("other", ["p", "chi2", "image"], "image"), judged=False),
    Result("lightdome", "ramps", "steeper", figures("steeper", ["p", "tiny", "sum", "drawn", "flux"], "drawn")),
    Result("lightdome", "zeros", "odd", {"p": math.nan, "zero": 3.0, "chi2": math.inf, "image": 4.1e-6}),
    Result("lightdome", "zeros", "huge", skipped="no room"),
]
OWN = [r for r in RESULTS if r.program == "lightdome"]


def is_figure(shown: str, value: float | None) -> bool:
    """Whether a cell shows ``value``: to one digit, or two near 1."""
    if value is None:
        return shown == ""
    if not math.isfinite(value):
        return shown == ("NaN" if math.isnan(value) else "inf")
    return shown != "" and close(shown, value, 2 if 0.01 <= value < 1000 else 1)


@pytest.mark.parametrize("value", [0.0, 3.14e-30, 2e-7, 0.0099, 0.013, 0.96, 1.72, 99.4, 137.0, 998.0, 1.4e3, 2.6e30])
def test_a_figure_s_few_characters_say_what_it_is(value: float) -> None:
    assert is_figure(stability.text(value), value)
    assert len(stability.text(value)) <= 5


def test_the_stability_picture_has_every_figure_in_its_cell() -> None:
    figure = stability_plot.table(RESULTS, "a title")
    assert [text.get_text() for text in figure.texts] == ["a title"]
    rows = [r.case for r in OWN]
    for axes, program in zip(figure.axes, ("lightdome", "mitsuba"), strict=True):
        assert axes.get_xlabel() == program
        found = {r.case: r for r in RESULTS if r.program == program}
        columns = [name for name in COLUMNS if any(name in r.figures for r in found.values())]
        heads = [tick.get_text().split("\n≤ ") for tick in axes.get_xticklabels()]
        assert [head for head, _ in heads] == [stability_plot.HEADS[name] for name in columns]
        for (_, goal), name in zip(heads, columns, strict=True):
            assert is_figure(goal, COLUMNS[name].goal)
        cells: dict[tuple[int, int], list[str]] = {}
        for text in axes.texts:
            if text.get_transform() == axes.transData:
                x, y = text.get_position()
                cells.setdefault((int(x), int(y)), []).append(text.get_text())
        picture = np.array(axes.images[0].get_array())
        for y, case in enumerate(rows):
            result = found.get(case)
            for x, name in enumerate(columns):
                value = result.figures.get(name) if result else None
                texts = [text for text in cells.get((x, y), []) if text]
                if result and result.skipped:
                    assert texts == ([result.skipped] if x == 0 else [])
                elif value is None:
                    assert texts == []
                else:
                    (shown,) = texts
                    assert is_figure(shown, value)
                    # Light if the goal is met, dark if not.
                    assert (picture[y, x].mean() > 0.7) == (value <= COLUMNS[name].goal)
    labels = [
        (t.get_position()[1], t.get_text())
        for t in figure.axes[0].texts
        if t.get_transform() != figure.axes[0].transData
    ]
    assert labels == [(0, "steep"), (0, "ramps"), (1, "steeper"), (2, "odd"), (2, "zeros"), (3, "huge")]


def test_the_stability_files_hold_every_figure(tmp_path: Path) -> None:
    stability.write_stability_csv(tmp_path / "stability.csv", RESULTS)
    stability.write_stability_json(tmp_path / "stability.json", RESULTS, {"options": 3})
    with (tmp_path / "stability.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    data = json.loads((tmp_path / "stability.json").read_text())
    assert data["options"] == 3
    assert data["columns"] == {name: {"goal": c.goal, "meaning": c.meaning} for name, c in COLUMNS.items()}
    verdicts = ["holds", "measured", "FAILS", "FAILS", "skipped"]
    for row, case, result, verdict in zip(rows, data["cases"], RESULTS, verdicts, strict=True):
        head = {"program": result.program, "group": result.group, "case": result.case, "verdict": verdict}
        assert {name: row[name] for name in head} == head
        assert {name: case[name] for name in head} == head
        assert {name: row[name] for name in (*COLUMNS, *LIMITS) if row[name]} == {
            name: str(value) for name, value in result.figures.items()
        }
        assert {name: float(value) for name, value in case["figures"].items()} == pytest.approx(
            result.figures, nan_ok=True, rel=0
        )


# ---- the report ----


def settings_of(name: str, seed: int, **options: object) -> dict[str, object]:
    """The settings of a part, different for every part."""
    return {
        "machine": {"processor": f"processor {seed}", "cores": seed, "system": f"system {seed}"},
        "device": {"name": f"device {seed}", "implementation": f"OpenCL  {seed}.0"},
        "versions": {"lightdome": f"{seed}.1", "numpy": f"{seed}.2"},
        "map": {"width": 32 + seed, "height": 16 + seed, "sha256": f"{seed:064x}"},
        "options": {"seed": 100 + seed, "sequence": f"sequence of {name}", **options},
        "files": {},
    }


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    """A report's numbers, and what they were made from."""
    folder = tmp_path_factory.mktemp("results")
    folders = {name: folder / name for name in ("part1", "part2", "part3", "part4", "bench", "stability")}
    for path in folders.values():
        path.mkdir()
    angles = {"brewster_entering_deg": 54.123456, "brewster_leaving_deg": 35.765432, "critical_entering_deg": None}
    (folders["part1"] / "fresnel.json").write_text(json.dumps({"version": "1.2.3", "eta": 1.4, **angles}))
    rng = np.random.default_rng(5)
    samples = {}
    for count in (6, 40):
        pixel = rng.integers(0, 3, (count, 2))
        direction = reference.directions(4, 8)[pixel[:, 1], pixel[:, 0]].astype(np.float32)
        probability = (0.01 + 0.04 * pixel[:, 0] + 0.013 * pixel[:, 1]).astype(np.float32)
        samples[count] = Samples(direction, np.ones((count, 3)), probability, pixel, (4, 8), "sobol", 77)
        samples[count].save(folders["part2"] / f"samples_{count}.npz")
    exact, by_areas, *others = spheres(6, 70)
    images = report.Images(
        dict(zip((6, 40), others[:2], strict=True)), dict(zip((8, 32), others[2:], strict=True)), exact, by_areas
    )
    parts = {
        "part1": settings_of("part1", 1),
        "part2": settings_of("part2", 2),
        "part3": settings_of("part3", 3),
        "part4": settings_of("part4", 4) | {"pbrt": "PBRT-v4"},
    }
    bench = settings_of("bench", 5, resolution=123, seeds=9, repeats=4)
    bench |= {"measurements": [asdict(p) for p in POINTS], "peers": {"pbrt": {}}, "absent": {"mitsuba": "not there"}}
    path = folder / "stability.json"
    made_with = settings_of("stability", 6, draws=54321) | {"peers": {"mitsuba": {"mitsuba": "3.9"}}, "absent": {}}
    stability.write_stability_json(path, RESULTS, made_with)
    results = report.Results(folders, parts | {"bench": bench, "stability": json.loads(path.read_text())})
    radiance = stiff_radiance(9, 18)
    numbers = report.numbers(EnvironmentMap(radiance), "the map.exr", results, images)
    json.dumps(numbers, allow_nan=False)
    return SimpleNamespace(d=numbers, images=images, samples=samples, radiance=radiance)


TEMPLATE = (Path(report.__file__).with_name("report.typ")).read_text(encoding="utf-8")


def table(told: SimpleNamespace, name: str) -> list[dict[str, str]]:
    """The rows of the table ``name`` in the report's source, by their column headers."""
    (heads,) = re.findall(rf"numbers\(\s*\((\[.*\])\s*,?\s*\),\s*d\.{name}\b", TEMPLATE)
    names = re.findall(r"\[([^\]]*)\]", heads)
    return [dict(zip(names, row, strict=True)) for row in told.d[name]]


def averaged(image: np.ndarray, side: int) -> np.ndarray:
    """Means over the squares that lie in the disc, one by one."""
    mask = disc_mask(len(image))
    places = range(0, len(image) - side + 1, side)
    squares = [np.s_[y : y + side, x : x + side] for y in places for x in places]
    return np.array([image[s].astype(np.float64).mean(axis=(0, 1)) for s in squares if mask[s].all()])


def left(image: np.ndarray, exact: np.ndarray, side: int) -> float:
    a, b = averaged(image, side), averaged(exact, side)
    return math.sqrt(((a - b) ** 2).sum() / (b**2).sum())


def test_the_report_s_errors_are_in_percent_against_their_own_exact_image(told: SimpleNamespace) -> None:
    images = told.images
    assert told.d["counts"] == [6, 40]
    assert told.d["spp"] == [8, 32]
    for name, count, of_kind, exact in (
        ("shared", "samples", images.shared, images.exact),
        ("per_pixel", "samples per pixel", images.per_pixel, images.exact_per_pixel),
    ):
        mask = disc_mask(len(exact))
        for row, (n, image) in zip(table(told, name), of_kind.items(), strict=True):
            difference = image[mask].astype(np.float64) - exact[mask]
            assert row[count] == str(n)
            assert close(row["relative RMSE, %"], 100 * rmse(image, exact))
            assert close(row["largest error, %"], 100 * np.abs(difference).max() / exact.max())
            assert rounded(row["mean error, %"], 100 * difference.mean() / exact[mask].mean(dtype=np.float64))
    kinds = [(n, i, images.exact, "shared") for n, i in images.shared.items()]
    kinds += [(n, i, images.exact_per_pixel, "per pixel") for n, i in images.per_pixel.items()]
    assert told.d["averaged"] == 16
    heads = ("image", "RMSE, %", "over squares of #d.averaged, %", "times smaller")
    for row, (n, image, exact, kind) in zip(told.d["averaging"], kinds, strict=True):
        cells = dict(zip(heads, row, strict=True))
        assert cells["image"] == f"{n} {kind}"
        before, after = left(image, exact, 1), left(image, exact, 16)
        assert close(cells["RMSE, %"], 100 * before)
        assert close(cells["over squares of #d.averaged, %"], 100 * after)
        assert rounded(cells["times smaller"], before / after)
    assert ", ".join(f"[{head}]" for head in heads) in TEMPLATE
    distances = {
        (f"{a} shared", f"{b} per pixel"): abs(math.log(rmse(i, images.exact) / rmse(j, images.exact_per_pixel)))
        for a, i in images.shared.items()
        for b, j in images.per_pixel.items()
    }
    assert tuple(told.d["pair"]) == min(distances, key=distances.get)
    assert told.d["resolution"] == 70
    assert told.d["pixels"] == f"{disc_mask(70).sum():,}"


def test_the_report_says_what_was_drawn(told: SimpleNamespace) -> None:
    for row, (count, samples) in zip(table(told, "drawn"), told.samples.items(), strict=True):
        pixels = [tuple(pixel) for pixel in samples.pixel]
        p = samples.probability.max()
        likeliest = pixels[list(samples.probability).index(p)]
        assert row["samples"] == str(count)
        assert row["different pixels"] == str(len(set(pixels)))
        assert rounded(row["largest $p$ drawn, %"], 100 * p)
        assert rounded(row["draws of it expected"], count * p)
        assert row["drawn"] == str(pixels.count(likeliest))
    luminance = np.sort(told.radiance.mean(axis=2, dtype=np.float64).ravel())[::-1]
    half = next(n for n in range(1, luminance.size + 1) if luminance[:n].sum() >= luminance.sum() / 2)
    of_map = told.d["map"]
    assert of_map["peak_over_mean"] == f"{luminance[0] / luminance.mean():,.0f}"
    assert (of_map["half"], of_map["pixels"], of_map["name"]) == (f"{half:,}", "162", "the map.exr")
    # Those of part 2, whatever the other parts were made with.
    assert (of_map["width"], of_map["height"], of_map["sha256"]) == (34, 18, f"{2:064x}")
    assert (told.d["seed"], told.d["sequence"], told.d["version"]) == ("102", "sequence of part2", "2.1")


def test_the_report_s_benchmark_is_the_one_measured(told: SimpleNamespace) -> None:
    rows = table(told, "seeds")
    of_it = [p for p in POINTS if p.method in ("independent", "light")]
    for row, p in zip(rows, of_it, strict=True):
        assert (row["method"], row["count"], row["seeds"]) == (p.method, str(p.count), str(p.seeds))
        assert close(row["RMSE, %"], 100 * p.rmse)
        assert close(row["spread over seeds, %"], 100 * p.rmse_spread)
        assert rounded(row["mean error over seeds, %"], 100 * p.bias)
    rows = table(told, "cheapest")
    assert [row["error, at most, %"] for row in rows] == ["10", "3", "1", "0.3"]
    for row in rows:
        best = fastest(POINTS, float(row.pop("error, at most, %")) / 100)
        assert (row["cheapest method"], row["count"]) == (best.method, str(best.count))
        assert rounded(row["milliseconds"], 1e3 * best.wall_seconds)
        assert rounded(row["its error, %"], 100 * best.rmse)
        if best.method != "exact":  # its error is below all digits shown
            assert close(row["its error, %"], 100 * best.rmse)
    assert close(told.d["exact_seconds"], POINTS[-1].wall_seconds, 2)
    assert told.d["bench"] == {
        "resolution": 123,
        "seeds": 9,
        "repeats": 4,
        "peers": ["pbrt"],
        "absent": ["mitsuba (not there)"],
    }
    angles = {"brewster_entering_deg": "54.1235", "brewster_leaving_deg": "35.7654", "critical_entering_deg": None}
    assert told.d["fresnel"] == {"version": "1.2.3", "eta": "1.4", **angles}


def test_the_report_s_stability_table_is_the_one_measured(told: SimpleNamespace) -> None:
    found = told.d["stability"]
    assert found["draws"] == "54,321"
    assert (found["holds"], found["fails"], found["skipped"]) == (1, 2, 1)
    for shown, program in ((found["own"], "lightdome"), *((peer, "mitsuba") for peer in found["peers"])):
        assert shown["program"] == program
        results = [r for r in RESULTS if r.program == program]
        columns = [name for name in COLUMNS if any(name in r.figures for r in results)]
        assert [name for name, *_ in shown["columns"]] == columns
        for name, goal, meaning in shown["columns"]:
            assert is_figure(goal, COLUMNS[name].goal)
            assert meaning == COLUMNS[name].meaning
        for row, r in zip(shown["rows"], results, strict=True):
            assert (row["group"], row["case"]) == (r.group, r.case)
            assert row["note"] == ("" if r.verdict in ("holds", "measured") else r.verdict)
            for cell, name in zip(row["cells"], columns, strict=True):
                value = r.figures.get(name)
                missed = value is not None and not value <= COLUMNS[name].goal
                assert is_figure(cell["text"], value)
                assert cell["dark"] == missed
                light = np.mean(matplotlib.colors.to_rgb(cell["fill"])) > 0.7
                assert light != missed


def test_the_report_says_what_each_result_was_made_with(told: SimpleNamespace) -> None:
    said = {text: names for names, text in told.d["made_with"]}
    for seed, name in enumerate(("part1", "part2", "part3", "part4", "bench", "stability"), 1):
        versions = f"lightdome {seed}.1, numpy {seed}.2"
        assert said.pop(f"processor {seed}; {seed} cores; system {seed}; {versions}") == [name]
        assert said.pop(f"OpenCL on device {seed}, OpenCL {seed}.0") == [name]
    assert said == {"PBRT-v4": ["part4"], "pbrt": ["bench"], "mitsuba (mitsuba 3.9)": ["stability"]}
    assert told.d["renderer"] == "PBRT-v4"


def filled(d: Mapping[str, object]) -> str:
    """The report's source with values for the plain names of numbers in it, on one line."""

    def value(match: re.Match[str]) -> str:
        found: object = {"d": d, "f": d["fresnel"]}[match[1]]
        for name in match[2].strip(".").split("."):
            if not isinstance(found, Mapping) or name not in found:
                return match[0]
            found = found[name]
        return str(found) if isinstance(found, str | int) else match[0]

    return " ".join(re.sub(r"#(d|f)((?:\.\w+)+)(?!\()", value, TEMPLATE).split())


@pytest.mark.parametrize(
    "sentence",
    [
        "the median of 4 runs after a warm-up, at 123 #sym.times 123 pixels",
        "Its error is the mean over 9 seeds",
        "Error against run time at 123 #sym.times 123 pixels",
        "up to chance over 9 seeds",
        "from the benchmark at 123 #sym.times 123 pixels",
        "directions (sequence of part2 points, seed 102)",
        "This map has 34 #sym.times 18 pixels.",
        "pixels of the sphere (albedo 1, 70 #sym.times 70 pixels",
        "Over 16 #sym.times 16 pixels, the error of shared samples",
        "1 hold, 2 fail and 1 were skipped, with 54,321 draws per case",
        "lightdome 2.1 on the environment map",
    ],
)
def test_numbers_are_in_the_sentences_they_belong_to(told: SimpleNamespace, sentence: str) -> None:
    assert sentence in filled(told.d)


def test_the_pictures_of_bias_and_noise_are_in_percent_of_the_mean(told: SimpleNamespace) -> None:
    images = told.images
    shared, per_pixel = images.shared[6], images.per_pixel[8]
    figure = report_figures.bias_and_noise(
        ("6 shared", shared), ("8 per pixel", per_pixel), images.exact, images.exact_per_pixel
    )
    pictures = {axes.get_title(): axes.images[0] for axes in figure.axes if axes.images and axes.get_title()}
    mask = disc_mask(70)
    mean = images.exact[mask].mean(dtype=np.float64)
    (bar,) = [axes for axes in figure.axes if axes.get_label() == "<colorbar>"]
    assert bar.get_xlabel() == "error, % of the mean radiance"
    for name, image, exact in (("6 shared", shared, images.exact), ("8 per pixel", per_pixel, images.exact_per_pixel)):
        difference = (image.astype(np.float64) - exact).mean(axis=2) / mean
        np.testing.assert_allclose(
            pictures[name].get_array()[mask] * unit(bar.get_xlabel()), difference[mask], atol=1e-6
        )
    sizes = []
    for image, exact in ((shared, images.exact), (per_pixel, images.exact_per_pixel)):
        difference = (image.astype(np.float64) - exact).mean(axis=2)[mask] / mean
        sizes.append(np.percentile(np.abs(difference), 98))
    for picture in pictures.values():
        assert picture.norm.vmax * unit(bar.get_xlabel()) == pytest.approx(max(sizes))
        assert picture.norm.vmin == -picture.norm.vmax
    (curves,) = [axes for axes in figure.axes if axes.lines and axes.get_xlabel().startswith("x on")]
    assert curves.get_ylabel() == "radiance, mean of R, G, B"
    x = np.flatnonzero(mask[35])
    for name, data in lines(curves).items():
        image = {"6 shared": shared, "8 per pixel": per_pixel, "exact": images.exact}[name]
        np.testing.assert_allclose(data, np.stack([x, image[35, x].astype(np.float64).mean(axis=1)], axis=1))
    assert len(lines(curves)) == 3


def test_averaging_is_in_percent_over_sides(told: SimpleNamespace) -> None:
    images = told.images
    named, own = images.named(), (images.exact, images.exact_per_pixel)
    (axes,) = report_figures.averaging(*named, *own).axes
    assert "RMSE" in axes.get_ylabel()
    assert "side" in axes.get_xlabel()
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    found = lines(axes)
    sides = (1, 2, 4, 8, 16)  # no larger square of the grid fits into this disc
    for of_kind, exact in zip(named, own, strict=True):
        for name, image in of_kind.items():
            expected = [(side, left(image, exact, side)) for side in sides]
            np.testing.assert_allclose(found.pop(name)[: len(sides)], expected, rtol=1e-6)
            start = expected[0][1]
    ((name, falls),) = found.items()
    assert name == "1 / side"
    np.testing.assert_allclose(falls[:, 1] * falls[:, 0], start)
    assert [tick.get_text() for tick in axes.get_xticklabels()] == [str(side) for side in falls[:, 0].astype(int)]


def test_the_cdfs_drawn_are_those_of_the_definition(device: Device) -> None:
    radiance = stiff_radiance(12, 40)
    figure = report_figures.cdfs(build_distribution(device, EnvironmentMap(radiance)))
    by_title = {axes.get_title(loc="left"): axes for axes in figure.axes if axes.get_title(loc="left")}
    p = reference.probability(radiance)
    marginal = np.cumsum(p.sum(axis=1))
    of_strips = np.split(p, reference.strip_borders(40)[1:-1], axis=1)
    assert len(of_strips) == 2
    rows = [np.cumsum(q, axis=1) / np.maximum(q.sum(axis=1, keepdims=True), 1e-300) for q in of_strips]
    rows = np.concatenate(rows, axis=1)
    over_rows = by_title["P(y | s), the CDFs over rows"]
    for line, q in zip(over_rows.lines, of_strips):  # noqa: B905 (lines of the three rows follow)
        x, y = line.get_data()
        np.testing.assert_allclose(x, np.cumsum(q.sum(axis=1)) / q.sum(), atol=1e-6)
        np.testing.assert_array_equal(y, range(12))
    picture = by_title["P(x | y, s), every row's CDFs"].images[0]
    np.testing.assert_allclose(picture.get_array(), rows, atol=1e-6)
    assert (picture.norm.vmin, picture.norm.vmax) == (0, 1)
    some = by_title["P(x | y, s) of the three rows"]
    chosen = [int(np.flatnonzero(marginal >= level)[0]) for level in (0.25, 0.5, 0.75)]
    assert legend(some) == [f"y = {y}" for y in chosen]
    for line, y in zip(some.lines, chosen, strict=True):
        np.testing.assert_allclose(line.get_ydata(), rows[y], atol=1e-6)
    for title in ("P(y | s), the CDFs over rows", "the map, and three of its rows"):
        assert {float(line.get_ydata()[0]) for line in by_title[title].lines if len(line.get_ydata()) == 2} == set(
            chosen
        )
    assert some.get_xlabel() == "x, pixels"
    assert {by_title[t].get_ylabel() for t in by_title if t != "P(x | y, s) of the three rows"} == {"y, pixels"}


# ---- Fresnel ----


def textbook(degrees: float, n_i: float, n_t: float) -> tuple[float, float]:
    p, s = reference.fresnel(math.radians(degrees), n_i, n_t)
    return float(p), float(s)


def shown_numbers(axes: Axes) -> str:
    """The text in axes, with powers of ten as Python reads them."""
    texts = "; ".join(text.get_text() for text in axes.texts if text.get_text()).replace("\n", " ")
    return re.sub(r"\$(\S+) \\times 10\^\{(-?\d+)\}\$", r"\1e\2", texts)


@pytest.mark.parametrize("sides", [(1.0, 1.7), (1.7, 1.0)])
def test_fresnel_plots_show_the_textbook_s_values_over_degrees(sides: tuple[float, float]) -> None:
    n_i, n_t = sides
    figure = plot.fresnel_figure(n_i, n_t, "there", "here")
    (axes,) = figure.axes
    assert axes.get_xlabel() == "angle of incidence (degrees)"
    assert axes.get_ylabel() == "reflectance (fraction of incident power)"
    assert axes.get_xlim() == (0, 90)
    assert (axes.get_xscale(), axes.get_yscale()) == ("linear", "linear")
    assert axes.get_title().endswith(f"there ($n_i$ = {n_i:g}) to here ($n_t$ = {n_t:g})")
    curves = {line.get_label(): np.array(line.get_data(), float).T for line in axes.lines if line.get_label()[0] != "_"}
    assert set(curves) == {"$R_s$, perpendicular", "unpolarised", "$R_p$, parallel"}
    for label, data in curves.items():
        for degrees, value in data[:: len(data) // 40]:
            p, s = textbook(degrees, n_i, n_t)
            expected = {"$R_s$": s, "$R_p$": p, "unpolarised": (p + s) / 2}[label.split(",")[0]]
            assert value == pytest.approx(expected, abs=1e-6)
    r0, said = (0.7 / 2.7) ** 2, shown_numbers(axes)
    assert close(re.search(r"normal incidence \$R_p\$ = \$R_s\$ = ([\d.e-]+)", said)[1], r0, 5)
    brewster = math.degrees(math.atan(n_t / n_i))
    assert close(re.search(r"Brewster's angle ([\d.]+)°", said)[1], brewster, 6)
    places = sorted(tuple(np.ravel(line.get_data())) for line in axes.lines if line.get_marker() == "o")
    expected = [(0, r0), (brewster, 0)]
    critical = re.search(r"critical angle ([\d.]+)°", said)
    assert bool(critical) == (n_i > n_t)
    if critical:
        at = math.degrees(math.asin(n_t / n_i))
        assert close(critical[1], at, 6)
        expected.append((at, 1))
    np.testing.assert_allclose(places, sorted(expected), atol=1e-12)


@pytest.mark.parametrize("sides", [(1.0, 1.7), (1.7, 1.0)])
def test_schlick_s_plots_show_the_difference_and_its_largest(sides: tuple[float, float]) -> None:
    n_i, n_t = sides
    above, below = plot.schlick_figure(n_i, n_t, "there", "here").axes
    assert below.get_xlabel() == "angle of incidence (degrees)"
    assert above.get_ylabel() == "reflectance (fraction of incident power)"
    assert below.get_ylabel() == "Schlick minus exact"
    r0 = (0.7 / 2.7) ** 2

    def schlick(degrees: np.ndarray) -> np.ndarray:
        return r0 + (1 - r0) * (1 - np.cos(np.radians(degrees))) ** 5

    curves = {line.get_label(): np.array(line.get_data(), float) for line in above.lines if line.get_label()[0] != "_"}
    x, exact = curves.pop("exact, unpolarised")
    for degrees, value in zip(x[::25], exact[::25], strict=True):
        assert value == pytest.approx(sum(textbook(degrees, n_i, n_t)) / 2, abs=1e-6)
    approximations = [schlick(x)]
    if n_i > n_t:
        sine = np.minimum(n_i / n_t * np.sin(np.radians(x)), 1)
        approximations.append(schlick(np.degrees(np.arcsin(sine))))
    names = [["Schlick"], ["Schlick, incident angle", "Schlick, transmitted angle"]][n_i > n_t]
    assert list(curves) == names
    differences = [line for line in below.lines if len(line.get_xdata()) == len(x)]
    said = [text.get_text() for text in below.texts if text.get_text()]
    heads = [["largest absolute error "], ["incident angle: at most ", "transmitted angle: at most "]][n_i > n_t]
    for name, expected, line, text, head in zip(names, approximations, differences, said, heads, strict=True):
        np.testing.assert_allclose(curves[name], [x, expected], atol=1e-6)
        np.testing.assert_allclose(line.get_data(), [x, expected - exact], atol=1e-6)
        assert text.startswith(head)
        largest, at = re.fullmatch(r"([\d.e-]+) at ([\d.]+)°", text.removeprefix(head).replace("\n", " ")).groups()
        error = np.abs(expected - exact)
        assert close(largest, error.max(), 3)
        assert float(at) == pytest.approx(x[error.argmax()], abs=0.2)
    assert close(re.search(r"\$R_0\$ = ([\d.e-]+)", shown_numbers(above))[1], r0, 5)


@pytest.mark.parametrize("eta", [1.4, 50.0])
def test_no_difference_from_schlick_is_larger_than_the_largest_named(eta: float) -> None:
    for sides in ((1.0, eta), (eta, 1.0)):
        below = plot.schlick_figure(*sides).axes[1]
        drawn = max(float(np.abs(np.asarray(line.get_ydata(), float)).max()) for line in below.lines)
        said = " ".join(text.get_text() for text in below.texts)
        assert max(float(number) for number in re.findall(r"(?:error|at most) ([\d.]+) at", said)) >= drawn - 1e-4
        assert ("largest" in said) == (sides[0] < sides[1])  # of two curves, each has its own


def test_part_1_writes_and_says_the_textbook_s_values(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], drawn: dict[str, Figure]
) -> None:
    monkeypatch.setattr(sys, "argv", ["part1_fresnel.py", "--eta", "1.7", "--out", str(tmp_path)])
    module_of("part1_fresnel").main()
    assert set(drawn) == {f"{what}_{way}" for what in ("fresnel", "schlick") for way in ("entering", "leaving")}
    r0 = (0.7 / 2.7) ** 2
    degrees = np.linspace(0, 90, 18_001)
    schlick = r0 + (1 - r0) * (1 - np.cos(np.radians(degrees))) ** 5
    # The reflectance of unpolarised light by Snell's law and complex cosines; beyond the critical angle it is 1.
    worst = {}
    for way, ratio in (("entering", 1 / 1.7), ("leaving", 1.7)):
        cosine = np.cos(np.radians(degrees))
        refracted = np.sqrt(1 - (ratio * np.sin(np.radians(degrees))) ** 2 + 0j)
        s = np.abs((ratio * cosine - refracted) / (ratio * cosine + refracted)) ** 2
        p = np.abs((cosine - ratio * refracted) / (cosine + ratio * refracted)) ** 2
        error = np.abs(schlick - (p + s) / 2)
        worst[way] = error.max(), degrees[error.argmax()]
    expected = {
        "eta": 1.7,
        "normal_reflectance_p": r0,
        "normal_reflectance_s": r0,
        "brewster_entering_deg": math.degrees(math.atan(1.7)),
        "brewster_leaving_deg": math.degrees(math.atan(1 / 1.7)),
        "critical_entering_deg": None,
        "critical_leaving_deg": math.degrees(math.asin(1 / 1.7)),
        "schlick_r0": r0,
        **{f"schlick_{way}_max_abs_error": worst[way][0] for way in worst},
        **{f"schlick_{way}_max_abs_error_at_deg": worst[way][1] for way in worst},
    }
    content = json.loads((tmp_path / "fresnel.json").read_text())
    content.pop("version")
    assert set(content) == set(expected)
    for name, value in expected.items():
        slack = 0.01 if name.endswith("at_deg") else 1e-3 if name.endswith("error") else 1e-9
        assert content[name] == (value if value is None else pytest.approx(value, abs=slack))
    said = capsys.readouterr().out
    for pattern, names in (
        (r"R_p = ([\d.]+), R_s = ([\d.]+)", ("normal_reflectance_p", "normal_reflectance_s")),
        (r"Brewster's angle +([\d.]+) entering, ([\d.]+) leaving", ("brewster_entering_deg", "brewster_leaving_deg")),
        (r"critical angle +none entering, ([\d.]+) leaving", ("critical_leaving_deg",)),
        (r"R0 = ([\d.]+);", ("schlick_r0",)),
        (
            r"([\d.]+) at ([\d.]+) entering, ([\d.]+) at ([\d.]+) leaving",
            [f"schlick_{way}_max_abs_error{at}" for way in ("entering", "leaving") for at in ("", "_at_deg")],
        ),
    ):
        found = re.search(pattern, said)
        assert found, pattern
        for shown, name in zip(found.groups(), names, strict=True):
            assert close(shown, content[name], 4)
