"""``lightdome catalog``: one row per map, the same for any number of workers, and resumed where it stopped."""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import OpenImageIO as oiio
import pytest
from helpers import LONG, Script, stiff_radiance
from lightdome.commands.catalog import clear
from lightdome.errors import LightdomeError
from lightdome.lighting.harmonics import project
from lightdome.lighting.median_cut import median_cut
from lightdome.maps import analyse
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.images import ImageRows, write_image
from lightdome.opencl.device import Device
from lightdome.sampling.distribution import build_distribution

pytest.importorskip("distributed")
pq = pytest.importorskip("pyarrow.parquet")

from distributed import Client, LocalCluster  # noqa: E402
from lightdome.catalog import computing, table, worker  # noqa: E402
from lightdome.catalog import row as row_module  # noqa: E402
from lightdome.catalog.columns import columns, of_analysis  # noqa: E402
from lightdome.catalog.computing import Run, rows  # noqa: E402
from lightdome.catalog.journal import NAME, Journal  # noqa: E402
from lightdome.catalog.page import write_page  # noqa: E402
from lightdome.catalog.row import Options, ReadMap, Row, averaged, fill, read  # noqa: E402
from lightdome.catalog.sources import find  # noqa: E402

slow = pytest.mark.slow
EVERYTHING = Options(samples=8, light_format="csv", thumbnails=True)


def catalog(*arguments: object, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "lightdome", "catalog", *map(str, arguments)]
    return subprocess.run(
        command, capture_output=True, text=True, timeout=LONG, env={**os.environ, **environment}, check=False
    )


def filled(device: Device, path: Path, options: Options) -> Row:
    row = Row({})
    fill(row, read(path, options.memory), device, options, "name")
    return row


def test_a_row_is_what_the_library_says(device: Device, library: Path) -> None:
    """A row holds, bit for bit, what ``analyse``, ``median_cut`` and ``project`` return for the same file."""
    path = library / "m2.pfm"
    row = filled(device, path, Options(lights=4)).values
    envmap = EnvironmentMap.read(path)
    expected = of_analysis(analyse(path))
    assert {name: row[name] for name in expected} == expected
    lights = median_cut(build_distribution(device, envmap), 4)
    assert [light["flux_green"] for light in row["lights"]] == lights.flux[:, 1].tolist()
    assert [light["to_light_y"] for light in row["lights"]] == lights.direction[:, 1].tolist()
    flat = project(device, envmap, 2).coefficients.ravel().tolist()
    assert [value for name, value in row.items() if name.startswith("harmonics_") and "rmse" not in name] == flat
    assert 0 < row["lights_relative_rmse"] < 1
    assert 0 < row["harmonics_relative_rmse"] < 1


def test_only_what_is_asked_for_is_computed(device: Device, library: Path) -> None:
    options = Options(lights=0, harmonics=None)
    row = filled(device, library / "m2.pfm", options)
    assert not [name for name in row.values if "lights" in name or "harmonics" in name or "exact" in name]
    assert not row.files
    assert [name for name in (column.name for column in columns(options)) if name.startswith("seconds_")] == [
        "seconds_hash",
        "seconds_read",
        "seconds_info",
    ]


def test_every_value_has_a_column_and_numbers_have_units(device: Device, library: Path) -> None:
    options = Options(samples=8, light_format="csv", thumbnails=True)
    row = filled(device, library / "nan.exr", options)
    names = {column.name: column for column in columns(options)}
    assert set(row.values) <= set(names)
    assert {names[f"{kind}_file"].name for kind in options.files} <= set(row.values)
    assert not [name for name, column in names.items() if column.kind in (int, float) and not column.unit][:-1]
    assert (row.values["nan_pixels"], row.values["infinite_pixels"]) == (1, 1)


def test_a_map_in_bands_has_the_same_analysis_and_flux(device: Device, tmp_path: Path) -> None:
    radiance = stiff_radiance(64, 128)
    write_image(tmp_path / "map.exr", radiance)
    whole = filled(device, tmp_path / "map.exr", Options())
    options = Options(memory=64 * 64 * 128 // 4)
    found = read(tmp_path / "map.exr", options.memory)
    assert (found.step, type(found.rows)) == (2, ImageRows)
    banded = filled(device, tmp_path / "map.exr", options)
    for name in ("flux_red_radiance_sr", "samples_for_1_percent_error", "width_pixels", "sun_direction_x"):
        assert banded.values[name] == whole.values[name]
    assert banded.values["notes"].endswith("averaged to 64 x 32")
    assert banded.values["harmonics_0_red"] == pytest.approx(whole.values["harmonics_0_red"], rel=1e-4)
    fluxes = [sum(light["flux_blue"] for light in row.values["lights"]) for row in (whole, banded)]
    assert fluxes[0] == pytest.approx(fluxes[1], rel=1e-5)


def test_averaging_keeps_the_flux_of_odd_sizes() -> None:
    from lightdome.maps.geometry import solid_angles

    radiance = stiff_radiance(21, 43)
    small = averaged([(np.arange(9), radiance[:9]), (np.arange(9, 21), radiance[9:])], 21, 43, 7)
    assert small.shape == (3, 7, 3)
    whole = solid_angles(21, 43)
    first = (radiance[:7, :7].astype(float) * whole[:7, None, None]).sum((0, 1)) / (7 * whole[:7].sum())
    np.testing.assert_allclose(small[0, 0], first, rtol=1e-6)


def test_sources_are_folders_files_globs_and_lists(maps: Path, tmp_path: Path) -> None:
    everything = list(find([str(maps)]))
    assert [os.path.relpath(path, maps) for path in everything] == sorted(
        ["below/probe.exr", "black.pfm", "cut.exr", "nan.exr", "none.hdr"]
        + [f"m{n}.{'exr' if n % 2 else 'pfm'}" for n in range(6)]
    )
    assert list(find([f"{maps}/m?.pfm", str(maps / "m0.pfm")])) == [str(maps / f"m{n}.pfm") for n in (0, 2, 4)]
    (tmp_path / "more").mkdir()
    (tmp_path / "more" / "link.exr").symlink_to(maps / "m1.exr")
    (tmp_path / "more" / "folder").symlink_to(maps)
    assert list(find([str(tmp_path / "more")])) == [str(tmp_path / "more" / "link.exr")]
    (tmp_path / "list.txt").write_text("maps/m1.exr\n\nmaps/below\n")
    assert list(find([str(tmp_path / "list.txt")])) == [str(maps / "below" / "probe.exr"), str(maps / "m1.exr")]
    assert list(find([f"file://{maps}/below"])) == [f"file://{maps}/below/probe.exr"]
    for paths, words in (([f"{maps}/*.png"], "no file matches"), ([str(tmp_path / "no.txt")], "cannot read the list")):
        with pytest.raises(LightdomeError, match=words):
            find(paths)
    (tmp_path / "empty").mkdir()
    with pytest.raises(LightdomeError, match="no maps"):
        find([str(tmp_path / "empty")])


def test_a_name_that_is_not_utf_8_is_escaped(client: Client, tmp_path: Path) -> None:
    (tmp_path / "maps").mkdir()
    try:
        write_image(tmp_path / "maps" / "m.pfm", stiff_radiance(8, 16))
        (tmp_path / "maps" / "m.pfm").rename(tmp_path / "maps" / os.fsdecode(b"m\xff.pfm"))
    except OSError:
        pytest.skip("the file system takes only UTF-8 names")
    _, found = computed_here(client, tmp_path / "maps", tmp_path / "out", Options(harmonics=None))
    assert [*found] == [r"m\xff.pfm"]
    options = Options(lights=0, harmonics=None)
    table.write_csv(tmp_path / "catalog.csv", columns(options), partial(iter, found.values()))
    table.write_parquet(tmp_path / "catalog.parquet", columns(options), partial(iter, found.values()), 1)


def test_a_missing_path_is_an_error_on_the_command_line_and_a_row_from_a_list(maps: Path, tmp_path: Path) -> None:
    with pytest.raises(LightdomeError, match="map does not exist"):
        find([str(maps), str(tmp_path / "map")])
    (tmp_path / "list.txt").write_text("map\n")
    assert list(find([str(tmp_path / "list.txt")])) == [str(tmp_path / "map")]


def test_globs_find_what_folders_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the folder's own name; ``**`` does not follow links to folders."""
    here = tmp_path / "br [x]"
    (here / "below").mkdir(parents=True)
    for name in ("a.pfm", "README.md", "below/b.pfm"):
        (here / name).touch()
    (here / "below" / "up").symlink_to(here)
    (here / "link").symlink_to(here / "below")
    monkeypatch.chdir(here)
    assert list(find(["*.pfm", "*"])) == [str(here / name) for name in ("a.pfm", "below/b.pfm", "link/b.pfm")]
    for pattern in ("**/*.pfm", "**/", f"{tmp_path}/**/*.pfm"):
        assert list(find([pattern])) == [str(here / "a.pfm"), str(here / "below" / "b.pfm")]
    assert list(find(["link/../*.pfm"])) == [str(here / "a.pfm")]


def test_a_list_may_come_from_windows_and_have_comments(tmp_path: Path) -> None:
    names = ["a b .pfm", "line\u2028separator.pfm", "#.pfm"]
    (tmp_path / "list.txt").write_bytes(("\ufeff" + "\r\n".join(["# maps", *names[:2], "", "./#.pfm"])).encode())
    assert sorted(find([str(tmp_path / "list.txt")])) == sorted(str(tmp_path / name) for name in names)


def test_a_folder_that_cannot_be_listed_has_a_row(maps: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scan = os.scandir

    def refuse(path: str) -> Any:
        if path.endswith("below"):
            raise PermissionError(13, "Permission denied", path)
        return scan(path)

    monkeypatch.setattr(os, "scandir", refuse)
    assert str(maps / "below") in find([str(maps)])


def test_chained_urls_are_refused() -> None:
    with pytest.raises(LightdomeError, match="chained"):
        find(["zip://in/a.pfm::/tmp/m.zip"])


def journal_row(path: str, sha256: str = "ab") -> dict[str, Any]:
    return {"path": path, "sha256": sha256, "status": "done", "value": 0.1}


def test_the_journal_survives_a_line_that_was_cut_short(tmp_path: Path) -> None:
    with Journal(tmp_path, "key") as journal:
        journal.add(journal_row("a"), 1, 2)
        journal.add(journal_row("b"), 1, 2)
    content = (tmp_path / NAME).read_bytes()
    for length in range(len(content) // 2 + 1, len(content)):
        (tmp_path / NAME).write_bytes(content[:length])
        with Journal(tmp_path, "key") as journal:
            assert journal.entries.keys() == ({"a"} if length < len(content) - 1 else {"a", "b"})
            journal.add(journal_row("c"), 1, 2)
        with Journal(tmp_path, "key") as journal:
            assert {"a", "c"} <= journal.entries.keys()
            assert journal.row(journal.entries["c"]) == journal_row("c")
    with Journal(tmp_path, "another key") as journal:
        assert not journal.entries


def test_a_journal_has_one_writer(tmp_path: Path) -> None:
    pytest.importorskip("fcntl")
    with Journal(tmp_path, "key"), pytest.raises(LightdomeError, match="another process"):
        Journal(tmp_path, "key")


def test_a_journal_that_cannot_be_locked_says_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fcntl = pytest.importorskip("fcntl")

    def refuse(*_: object) -> None:
        raise OSError(37, "No locks available")

    monkeypatch.setattr(fcntl, "flock", refuse)
    with pytest.raises(LightdomeError, match=r"cannot lock .*No locks available"):
        Journal(tmp_path, "key")


def test_large_tables_are_partitioned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table, "PARTITION", 4)
    wanted = columns(Options(lights=0, harmonics=None))
    path = tmp_path / "catalog.parquet"
    for count in (3, 10, 9, 2):
        made = [{"path": f"{n:03}", "size_bytes": n} for n in range(count)]
        table.write_parquet(path, wanted, partial(iter, made), count)
        assert pq.read_table(path).column("size_bytes").to_pylist() == list(range(count))
        assert path.is_dir() == (count > 4)
        assert list(tmp_path.iterdir()) == [path]
    assert json.loads(pq.read_schema(path).metadata[b"units"])["size_bytes"] == "byte"


def test_a_table_that_cannot_be_written_leaves_the_old_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table, "PARTITION", 4)
    wanted, path = columns(Options(lights=0, harmonics=None)), tmp_path / "catalog.parquet"
    table.write_parquet(path, wanted, partial(iter, [{"path": "a"}] * 9), 9)

    def full(path: Path, *_: object) -> None:
        path.touch()
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(table, "_write", full)
    for count in (3, 9):
        with pytest.raises(LightdomeError, match="No space left"):
            table.write_parquet(path, wanted, partial(iter, [{"path": "b"}] * count), count)
        assert pq.read_table(path).column("path").to_pylist() == ["a"] * 9
        assert list(tmp_path.iterdir()) == [path]


def computed_here(client: Client, maps: Path, out: Path, options: Options) -> tuple[int, dict[str, dict[str, Any]]]:
    """How many rows were computed, and all rows by file name of the map."""
    sources = find([str(maps)])
    out.mkdir(exist_ok=True)
    with Journal(out, options.key) as journal:
        run = Run(sources, options, journal, out, LONG)
        if run.waiting:
            run(client)
        return run.total - run.known, {Path(row["path"]).name: row for row in rows(journal, sources)}


# With this code, a process that opens deadly.exr dies. Python 3.10's pathlib would make a method of a function.
DEADLY = """
import ctypes, io
opened = io.open
class OpenOrDie:
    def __call__(self, file, *more, **options):
        if str(file).endswith("deadly.exr"):
            ctypes.string_at(0)
        return opened(file, *more, **options)
io.open = OpenOrDie()
"""


@slow
@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_the_table_is_the_same_for_two_workers_and_maps_that_kill_or_hang_them(
    client: Client, library: Path, maps: Path, tmp_path: Path
) -> None:
    """Maps that end their worker are named and skipped; the others have the rows that one worker computes alone."""
    _, expected = computed_here(
        client, library, tmp_path / "expected", EVERYTHING
    )  # and compiles the kernels before time is limited
    (tmp_path / "code").mkdir()
    (tmp_path / "code" / "sitecustomize.py").write_text(DEADLY)
    (maps / "deadly.exr").write_bytes(b"")
    os.mkfifo(maps / "hanging.exr")  # a pipe that nobody writes to
    path, out = os.pathsep.join(filter(None, [str(tmp_path / "code"), os.environ.get("PYTHONPATH")])), tmp_path / "out"
    result = catalog(
        maps, "--out", out, "--workers", 2, "--timeout", 3, "--thumbnails", "--light-files", "csv", "--samples", 8,
        PYTHONPATH=path,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    assert "Dask's dashboard: http://127.0.0.1:" in result.stdout
    assert "13 maps: 9 computed, 0 already known, 4 failed" in result.stdout
    found = {Path(row["path"]).name: row for row in pq.read_table(out / "catalog.parquet").to_pylist()}
    assert {name for name, row in found.items() if row["status"] == "failed"} == {
        "cut.exr", "none.hdr", "deadly.exr", "hanging.exr",
    }  # fmt: skip
    assert found["deadly.exr"]["error"] == "its worker process died, again when alone: skipped"
    assert found["hanging.exr"]["error"] == "it took more than 3 s, again when alone: skipped"
    assert "cut.exr" in found["cut.exr"]["error"]

    for name, row in expected.items():
        if row["status"] == "done":
            same = [key for key in row if key != "path" and not key.startswith("seconds_")]
            assert {key: found[name][key] for key in same} == {key: row[key] for key in same}

    assert found["probe.exr"]["projection"] == "angular, resampled to latlong"
    assert found["black.pfm"]["lights"] is None
    for kind, folder in {"lights": "lights", "samples": "samples", "thumbnail": "thumbnails"}.items():
        assert (out / found["m0.pfm"][f"{kind}_file"]).parent == out / folder
        assert (out / found["m0.pfm"][f"{kind}_file"]).stat().st_size > 50
    with (out / "catalog.csv").open(newline="") as file:
        of_csv = {Path(row["path"]).name: row for row in csv.DictReader(file)}
    assert float(of_csv["m3.exr"]["harmonics_8_blue"]) == found["m3.exr"]["harmonics_8_blue"]
    assert json.loads(of_csv["m3.exr"]["lights"]) == found["m3.exr"]["lights"]


@pytest.mark.slow
def test_a_second_run_computes_what_is_new_changed_or_failed(client: Client, maps: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    computed, before = computed_here(client, maps, out, Options())
    assert worker._device.cache_info().misses == 1  # the device is opened once
    assert oiio.get_int_attribute("threads") == int(os.environ[worker.THREAD_VARIABLES[0]])
    assert computed == len(before) == 11
    assert computed_here(client, maps, out, Options())[0] == 2  # the damaged ones
    (maps / "m0.pfm").touch()  # hashed, not computed
    shutil.copy(maps / "m1.exr", maps / "copy.exr")
    shutil.copy(maps / "m1.exr", maps / "cut.exr")
    write_image(maps / "m2.pfm", stiff_radiance(8, 16, 99))
    computed, after = computed_here(client, maps, out, Options())
    assert (computed, len(after)) == (2, 12)
    assert {**after["copy.exr"], "path": 0} == {**after["m1.exr"], "path": 0} == {**after["cut.exr"], "path": 0}
    assert after["m0.pfm"] == before["m0.pfm"]  # even the times
    assert after["m2.pfm"]["sha256"] != before["m2.pfm"]["sha256"]
    assert computed_here(client, maps, out, Options(lights=2))[0] >= 10  # of 12, three of them equal


def page_of(path: Path, count: int) -> None:
    made = [
        {
            "path": f"/maps/map{n:05}.exr",
            "status": "done" if n % 10 else "failed",
            "error": None if n % 10 else "/maps: <b>damaged</b></script>",
            "width_pixels": 1024 * (1 + n % 4),
            "range_stops": (n * 37 % 1000) / 50 if n % 10 else None,
            "mean_direction_length": (n * 91 % 1000) / 1000 if n % 10 else None,
            "clipping_verdict": "clipped" if n % 3 else "not clipped",
        }
        for n in range(count)
    ]
    write_page(path, Options(), partial(iter, made))


@slow
def test_the_page_sorts_and_filters_ten_thousand_rows_in_a_browser(tmp_path: Path) -> None:
    api = pytest.importorskip("playwright.sync_api")
    browser = shutil.which("chromium")
    if browser is None:
        pytest.skip("needs chromium")
    page_of(tmp_path / "index.html", 10_000)
    with api.sync_playwright() as playwright:
        window = playwright.chromium.launch(executable_path=browser, args=["--no-sandbox"]).new_page()
        errors: list[object] = []
        window.on("pageerror", lambda error: errors.append(error))
        window.goto((tmp_path / "index.html").as_uri())
        assert window.inner_text("h1") == "10,000 maps"
        assert window.locator("#body .row").count() < 40
        window.get_by_role("button", name="stops").click()
        window.get_by_role("button", name="stops").click()
        assert window.locator("#body .row").first.inner_text().startswith("map")
        window.get_by_label("filter stops").fill(">19.9")
        window.get_by_label("filter status").fill("done")
        text = window.inner_text("#summary")
        assert 0 < int(text.split()[0]) < 60, text
        stops = [float(row.split("\n")[-2]) for row in window.locator("#body .row").all_inner_texts()]
        assert stops == sorted(stops, reverse=True)
        assert min(stops) > 19.9
        window.get_by_label("filter stops").fill("")
        window.get_by_label("filter status").fill("failed")
        assert "<b>damaged</b>" in window.locator("#body .row").first.inner_text()
        window.get_by_label("filter status").fill("")
        for label, text, count in (
            ("clipping", "clipped", "6,666"), ("stops", "<2e-2", "0"), ("stops", "1e0..2.5e0", "680"),
        ):  # fmt: skip
            window.get_by_label(f"filter {label}").fill(text)
            assert window.inner_text("#summary").startswith(f"{count} of"), window.inner_text("#summary")
            window.get_by_label(f"filter {label}").fill("")
        window.evaluate("document.getElementById('view').scrollTop = 1e9")
        window.wait_for_function("document.querySelector('#body .row:last-child').ariaRowIndex === '10001'")
        assert not errors


def test_the_next_map_is_read_while_one_is_computed(
    client: Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reads, is_next_read = [], threading.Event()

    def reading(path: Path, memory: int) -> ReadMap:
        reads.append(path)
        if len(reads) == 2:
            is_next_read.set()
        return read(path, memory)

    def filling(*of: Any) -> None:
        assert is_next_read.wait(20)
        fill(*of)

    (tmp_path / "maps").mkdir()
    for n in range(2):
        write_image(tmp_path / "maps" / f"m{n}.pfm", stiff_radiance(8, 16, n))
    monkeypatch.setattr(worker, "read", reading)
    monkeypatch.setattr(worker, "fill", filling)
    _, found = computed_here(client, tmp_path / "maps", tmp_path / "out", Options(harmonics=None))
    assert [row["error"] for row in found.values()] == [None, None]


def test_equal_maps_have_the_same_files_whatever_their_names(client: Client, library: Path, tmp_path: Path) -> None:
    (tmp_path / "maps").mkdir()
    for name in ("b", "a", "\N{CJK UNIFIED IDEOGRAPH-4E00}" * 80):
        shutil.copy(library / "m0.pfm", tmp_path / "maps" / f"{name}.pfm")
    _, found = computed_here(client, tmp_path / "maps", tmp_path / "out", Options(harmonics=None, thumbnails=True))
    assert {row["error"] for row in found.values()} == {None}
    (name,) = {row["thumbnail_file"] for row in found.values()}
    assert name == f"thumbnails/{found['a.pfm']['sha256'][:16]}_thumbnail.png"


def test_a_map_that_changes_while_it_is_read_fails(
    client: Client, maps: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def reading(path: Path, memory: int) -> ReadMap:
        path.write_bytes((maps / "m2.pfm").read_bytes())
        return read(path, memory)

    monkeypatch.setattr(worker, "read", reading)
    _, found = computed_here(client, maps / "m0.pfm", tmp_path / "out", Options(harmonics=None))
    assert found["m0.pfm"]["error"] == f"{maps / 'm0.pfm'} changed while it was being read"


@pytest.mark.parametrize(("height", "expected"), [(8191, 2), (8192, 2), (10007, 2)])
def test_large_maps_of_any_height_keep_their_resolution(height: int, expected: int) -> None:
    image = SimpleNamespace(height=height, width=2 * height)
    assert row_module._step(image, 3_300_000_000) == expected  # type: ignore[arg-type]


def test_a_large_map_of_a_prime_height_is_averaged(device: Device, tmp_path: Path) -> None:
    write_image(tmp_path / "map.exr", stiff_radiance(61, 122))
    whole, banded = (filled(device, tmp_path / "map.exr", Options(memory=memory)) for memory in (10**9, 64 * 61 * 61))
    assert banded.values["notes"].endswith("averaged to 61 x 31")
    assert banded.values["harmonics_0_red"] == pytest.approx(whole.values["harmonics_0_red"], rel=0.1)
    assert banded.values["lights_relative_rmse"] < 1


def test_what_cannot_be_written_is_not_blamed_on_the_cluster(
    client: Client, library: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "thumbnails").touch()
    with pytest.raises(LightdomeError, match=r"cannot write .*thumbnails: File exists"):
        computed_here(client, library / "m0.pfm", tmp_path, Options(harmonics=None, thumbnails=True))

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Journal, "add", full)
    with pytest.raises(LightdomeError, match=r"cannot write .*journal.jsonl: No space left"):
        computed_here(client, library / "m0.pfm", tmp_path, Options(harmonics=None))


def test_bad_arguments_are_told_in_one_line(run_here: Script, library: Path, tmp_path: Path) -> None:
    for option, value, words in (
        ("--limit-memory", "1e999", "must be a size"),
        ("--scheduler", "nonsense", "missing port"),
        ("--scheduler", "tcp://127.0.0.1:abc", "not the address"),
        ("--scheduler", "foo://127.0.0.1:1", "unknown address scheme"),
        ("--lights", "-1", "from 0 to"),
    ):
        result = run_here("catalog", library, "--out", tmp_path / "out", f"{option}={value}")
        assert result.returncode in (1, 2)
        assert words in result.stderr.splitlines()[-1]
        assert "Traceback" not in result.stderr


def test_workers_that_cannot_compute_end_the_run(client: Client, library: Path, tmp_path: Path) -> None:
    with pytest.raises(LightdomeError, match="nothing"):
        computed_here(client, library, tmp_path, Options(device="nothing"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(computing, "__version__", "0.0.1")
        with pytest.raises(LightdomeError, match=r"the workers have lightdome .*, not 0.0.1"):
            computed_here(client, library, tmp_path, Options())
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "lightdome", None)
        with pytest.raises(LightdomeError, match="the workers cannot import lightdome"):
            computed_here(client, library, tmp_path, Options())


def test_files_that_were_removed_are_made_again(client: Client, library: Path, tmp_path: Path) -> None:
    options = Options(harmonics=None, lights=0, thumbnails=True)
    _, found = computed_here(client, library / "m0.pfm", tmp_path, options)
    picture = tmp_path / found["m0.pfm"]["sphere_file"]
    picture.unlink()
    assert computed_here(client, library / "m0.pfm", tmp_path, options)[0] == 1
    assert picture.exists()


def test_a_row_belongs_to_one_version_and_its_options(monkeypatch: pytest.MonkeyPatch) -> None:
    key = Options().key
    assert Options(lights=2).key != key != Options(memory=1).key
    monkeypatch.setattr(row_module, "__version__", "another")
    assert Options().key != key
    assert "a different version" in worker.work("map.exr", Options(), key, [], None, LONG).values["error"]


def test_memory_in_which_no_worker_lives_is_refused(run_here: Script, library: Path, tmp_path: Path) -> None:
    for limit, words in (("300MB", "at least 1GB"), ("much", "must be a size such as")):
        result = run_here("catalog", library, "--out", tmp_path / "out", "--limit-memory", limit)
        assert (result.returncode, result.stderr.count("\n")) == (1, 1)
        assert words in result.stderr


def test_a_cluster_of_our_own_without_workers_gets_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(computing, "PATIENCE", 0.1)
    monkeypatch.setattr(computing, "ALONE", 20.0)
    with (
        Journal(tmp_path, "key") as journal,
        LocalCluster(n_workers=0, processes=False, dashboard_address="127.0.0.1:0") as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        run = Run({}, Options(), journal, tmp_path, LONG)
        run.client = client
        run._wait_for_worker()
        assert len(client.nthreads()) == 1


def test_only_unfinished_files_of_a_catalog_are_cleared(tmp_path: Path) -> None:
    (tmp_path / "lights").mkdir()
    (tmp_path / ".catalog.0123abcd.parquet").mkdir()
    unfinished = [tmp_path / ".index.0123abcd.html", tmp_path / "lights" / ".sky.0123abcd.csv"]
    others = [tmp_path / name for name in (".notes.0123abcd.txt", ".index.html", "index.0123abcd.html")]
    for path in (*unfinished, *others):
        path.touch()
    clear(tmp_path)
    assert sorted(path for path in tmp_path.rglob("*") if path.is_file()) == sorted(others)
    assert not (tmp_path / ".catalog.0123abcd.parquet").exists()


@slow
def test_ctrl_c_ends_it_cleanly_and_says_how_to_resume(tmp_path: Path) -> None:
    (tmp_path / "maps").mkdir()
    for n in range(60):
        write_image(tmp_path / "maps" / f"m{n:02}.pfm", stiff_radiance(64, 128, n))
    out = tmp_path / "out"
    command = [
        sys.executable,
        "-m",
        "lightdome",
        "catalog",
        str(tmp_path / "maps"),
        "--out",
        str(out),
        "--workers",
        "1",
    ]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    while process.poll() is None and not ((out / NAME).exists() and (out / NAME).stat().st_size):
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    _, errors = process.communicate(timeout=LONG)
    assert process.returncode == 130
    assert re.search(r"^\d+ of 60 maps are done and saved; run the same command again to resume$", errors, re.MULTILINE)
    assert "Traceback" not in errors
    assert [path.name for path in out.iterdir()] == [NAME]
