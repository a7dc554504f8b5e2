"""The limits are those of kernels that do their work, and stages are compared with them from correct counts."""

from __future__ import annotations

import argparse
import contextlib
import csv
import io
import json
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from helpers import stiff_radiance
from lightdome import reference
from lightdome.commands import roofline as command
from lightdome.disc import disc_mask
from lightdome.evaluation import roofline
from lightdome.evaluation.metrics import exponent
from lightdome.evaluation.roofline import Limits, StageMeasurement, Timing
from lightdome.evaluation.roofline_stages import MADE, MapStages, Stage, Work, harmonics, made_map, shading
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.geometry import row_angles
from lightdome.maps.images import write_image
from lightdome.opencl.device import Device
from lightdome.sampling.distribution import build_distribution

LIMITS = Limits({2**20: 80e9, 2**30: 20e9}, 100e9, 1e-5)
EVERY_STAGE = {
    *(
        "row cdf",
        "marginal cdf",
        "guide",
        "sample",
        "sample pixels",
        "median cut",
        "exact",
        "light",
        "bsdf",
        "mis",
        "product",
    ),
    *("shade", "shade brute force", "harmonics project", "harmonics shade"),
}


def point(
    stage: str, seconds: float, map: str = MADE, height: int = 8, resolution: int = 4, N: int = 2
) -> StageMeasurement:
    work = Work(1e6, 1e6, 1.0, "samples")
    timing = Timing(Stage(stage, print, work, None, map, (height, 2 * height), resolution, N), seconds, 0.0, 1, None)
    return roofline.rated(timing, LIMITS)


@pytest.mark.parametrize("size", [2**15, 3 * 2**15])
def test_the_copy_copies_every_byte(device: Device, size: int) -> None:
    copied, seconds = roofline.copy(device, size)
    assert copied.nbytes == size
    assert (copied == 1.5).all()
    assert seconds > 0


@pytest.mark.parametrize("steps", [0, 1, 1000])
def test_every_chain_of_multiply_adds_takes_every_step(device: Device, steps: int) -> None:
    sums, seconds = roofline.multiply_add(device, steps)
    chains = 1 if device.is_gpu else roofline.CHAINS
    starts = np.arange(16 * chains).reshape(chains, 16)
    assert (sums == (starts + steps).sum(axis=0)).all()
    assert seconds > 0


def test_bandwidth_is_that_of_a_copy_of_the_same_size() -> None:
    assert LIMITS.bandwidth(2**20) == pytest.approx(80e9)
    assert LIMITS.bandwidth(2**25) == pytest.approx(50e9)
    assert LIMITS.bandwidth(1) == pytest.approx(80e9)
    assert LIMITS.bandwidth(2**40) == pytest.approx(20e9)
    other = Limits({2**20: 70e9, 2**30: 30e9}, 90e9, 2e-5)
    assert LIMITS.best(other) == other.best(LIMITS) == Limits({2**20: 80e9, 2**30: 30e9}, 100e9, 1e-5)


def test_shares_are_of_the_binding_limit() -> None:
    moving = Stage("moving", print, Work(2**30, 1e9, 5.0, "pixels"))
    rated = roofline.rated(Timing(moving, 0.1, 0.0, 1, None), LIMITS)
    assert rated.bandwidth_share == pytest.approx(2**30 / 20e9 / 0.1)
    assert rated.multiply_add_share == pytest.approx(0.1)
    assert (rated.bound, rated.bound_share) == ("bandwidth", rated.bandwidth_share)
    assert rated.rate == pytest.approx(50)
    beside = roofline.rated(Timing(moving, 0.1, 0.0, 1, None, bandwidth=12e9), LIMITS)
    assert beside.bandwidth_share == pytest.approx(2**30 / 12e9 / 0.1)
    pairs = Work(2**20, 7e9, 1e9, "pairs", pairs=1e9, skips=True)
    rated = roofline.rated(Timing(replace(moving, work=pairs), 0.01, 0.0, 1, None), LIMITS)
    assert (rated.bound, rated.counted) == ("multiply-add", "brute force")
    assert rated.bound_share == rated.brute_force_ratio == pytest.approx(7)


def test_the_exponents_put_in_are_found() -> None:
    assert exponent([1, 10, 100], [3, 3 * 10**1.5, 3000]) == pytest.approx(1.5)
    assert exponent([4, 4], [1, 2]) is None
    assert exponent([1, 2], [0, 1]) is None
    points = [point("a", h**-2.5, height=h) for h in (8, 16, 64)]
    points += [point("a", r, map="photo", resolution=r) for r in (2, 4, 8)]
    points += [point("b", 1, N=n) for n in (2, 20)]
    found = roofline.exponents(points)
    assert found["map"] == {"a": pytest.approx(-1.25)}
    assert found["resolution"] == {"a": pytest.approx(0.5)}
    assert found["N"] == {"b": pytest.approx(0)}


def test_memory_that_a_run_takes_is_seen_although_it_is_free_again(device: Device) -> None:
    if not Path("/proc/self/clear_refs").exists():
        pytest.skip("this system does not tell the peak of a process's memory")
    for mib in (40, 160):  # more than malloc may have kept from earlier tests
        stage = Stage("taking", lambda mib=mib: np.ones(mib << 17), Work(1, 1, 1, "samples"))
        peak = roofline.time_stage(device, stage, 1).peak_bytes
        # A busy system takes and returns some pages by itself, but not half of them.
        assert mib / 2 < peak / 2**20 < 2 * mib


def test_a_stage_beside_a_copy_is_compared_with_it(device: Device) -> None:
    stages = [
        Stage("known", lambda: None, Work(2**18, 1, 1, "pixels"), events=(), beside_copy=b) for b in (True, False)
    ]
    beside, alone = (roofline.time_stage(device, stage, 3) for stage in stages)
    assert beside.bandwidth > 0
    assert beside.seconds == 0  # the copy's time is not the stage's
    assert alone.bandwidth is None


@pytest.mark.slow
def test_pairs_and_arcs_are_those_of_the_sphere(device: Device) -> None:
    resolution, envmap = 33, EnvironmentMap(stiff_radiance(64, 128))
    disc = disc_mask(resolution)
    fast, brute = shading(device, build_distribution(device, envmap), 5, resolution)
    assert fast.work.pairs == brute.work.pairs == 5 * disc.sum()
    assert fast.work.operations == brute.work.operations == 7 * 5 * disc.sum()

    (exact, *_) = MapStages(device, envmap, "stiff").images(resolution)
    assert exact.work.pairs == disc.sum() * 64 * 128
    # Rows that a pixel's horizon cuts have lights on both sides of it.
    theta, phi = row_angles(64)[:, None], np.linspace(0, 2 * np.pi, 721)
    w = np.stack(np.broadcast_arrays(np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)), axis=-1)
    cosine = np.einsum("hwk,nk->nhw", w, reference.normals(resolution)[disc])
    cut = (cosine.min(axis=2) < 0) & (cosine.max(axis=2) > 0)
    arcs = (exact.work.operations - 9 * 64 * 128) / 18
    assert arcs == pytest.approx(cut.sum(), rel=0.02)


def test_a_made_map_is_of_its_size_and_no_two_rows_are_alike() -> None:
    for height in (3, 600, 1024):
        radiance = made_map(height).radiance
        assert radiance.shape == (height, 2 * height, 3)
        assert len(np.unique(radiance.sum(axis=(1, 2)))) == height


def test_harmonics_count_their_terms(device: Device) -> None:
    # Orders 0, 1 and even orders: 6 multiply-adds per (l, m), 3 if m = 0; 2 per Legendre function.
    filtered = sum(3 + 6 * n for n in (0, 1, 2, 4, 6, 8, 10))
    assert harmonics(device, 33).work.operations == (filtered + 2 * 66) * disc_mask(33).sum()


@dataclass
class Ran:
    """The script's files and output."""

    out: Path
    data: dict
    printed: str


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Ran:
    """A small run of the script."""
    folder = tmp_path_factory.mktemp("roofline")
    write_image(folder / "map.pfm", stiff_radiance(16, 32))
    asked = {"map": folder / "map.pfm", "layer": None, "flip": False, "sanitize": None, "device": None}
    asked |= {"convention": "lightdome", "mirror": False, "rotate": None, "projection": None}
    asked |= {"out": folder / "out", "resolution": 17, "repeats": 2, "quick": True}
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        command.run(argparse.Namespace(**asked), ((16, 32), (33,), (4, 64)), (2**20, 2**21))
    data = json.loads((folder / "out" / "roofline.json").read_text())
    return Ran(folder / "out", data, printed.getvalue())


@pytest.mark.slow
def test_the_script_compares_every_stage_with_its_limit(ran: Ran) -> None:
    with (ran.out / "roofline.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    data = ran.data
    assert len(rows) == len(data["measurements"])
    assert {row["stage"] for row in rows} == EVERY_STAGE
    for row, measured in zip(rows, data["measurements"], strict=True):
        for share in ("bandwidth_share", "multiply_add_share", "bound_share"):
            assert float(row[share]) == measured[share] > 0
        assert measured["repeats"] == 2
    assert {row["resolution"] for row in rows if row["stage"] == "exact"} == {"17", "33"}
    assert {row["N"] for row in rows if row["stage"] == "sample"} == {"4", "64"}
    assert {row["height"] for row in rows if row["stage"] == "row cdf"} == {"16", "32"}
    assert data["limits"]["before"]["launch_seconds"] > 0
    assert set(data["exponents"]) == {"map", "resolution", "N"}
    pictures = {"roofline.png", "roofline_scaling.png"}
    assert {p.name for p in ran.out.iterdir()} == {"roofline.csv", "roofline.json"} | pictures


def shows(text: str, value: float) -> bool:
    """Whether a decimal number is ``value`` to its last place."""
    return float(text) == pytest.approx(value, abs=0.501 * 10.0 ** -len(text.partition(".")[2]))


@pytest.mark.slow
def test_the_script_prints_what_it_measured(ran: Ran) -> None:
    before, after = (
        Limits({int(size): rate for size, rate in limits.pop("copies").items()}, **limits)
        for limits in (dict(ran.data["limits"][when]) for when in ("before", "after"))
    )
    best = {size: max(rate, after.copies[size]) for size, rate in before.copies.items()}
    copies = re.findall(r"^copy of +(\d+) MiB: +([\d.]+) GB/s$", ran.printed, re.MULTILINE)
    assert [int(size) for size, _ in copies] == [1, 2]
    for size, rate in copies:
        assert shows(rate, 1e-9 * best[2**20 * int(size)])
    multiply_adds = max(before.multiply_adds, after.multiply_adds)
    assert shows(re.search(r"^multiply-adds: +([\d.]+) G/s$", ran.printed, re.MULTILINE)[1], 1e-9 * multiply_adds)
    launch = min(before.launch_seconds, after.launch_seconds)
    assert shows(re.search(r"^launch: +([\d.]+) us$", ran.printed, re.MULTILINE)[1], 1e6 * launch)

    table = ran.printed[ran.printed.index("stage  ") :].splitlines()
    heads = ["stage", "map", "image", "N", "ms", "spread", "M per second", "share of its limit"]
    assert re.split(r"\s{2,}", table[0].replace("map image", "map  image")) == heads
    points = [StageMeasurement(**measured) for measured in ran.data["measurements"]]
    for line, p in zip(table[1 : 1 + len(points)], points, strict=True):
        assert line[:18].strip() == p.stage
        size = f"{p.width} x {p.height}" if p.width else ""
        assert size in line
        shown = line[18:].replace(size, "", 1).split()
        sizes = [str(n) for n in (p.resolution, p.N) if n]
        assert shown[: len(sizes)] == sizes
        milliseconds, spread, rate, amount, share, *of = shown[len(sizes) :]
        assert shows(milliseconds, 1e3 * p.seconds)
        assert shows(spread, 1e3 * p.spread)
        assert shows(rate, 1e-6 * p.rate)
        assert amount == p.unit
        brute = p.stage == "shade"
        assert of == (["x", "brute", "force"] if brute else ["%", p.bound])
        assert shows(share, p.bound_share if brute else 100 * p.bound_share)
        assert p.multiply_add_share == pytest.approx(p.operations / multiply_adds / p.seconds)
