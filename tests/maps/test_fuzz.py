"""Damaged files are read or refused in one line; ``tests/tools/fuzz.py`` reads as many as you like."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import fuzz
import numpy as np
import OpenImageIO as oiio
import pytest
from helpers import CHROMA_IS_HIDDEN, Script, fails_in_one_line
from lightdome.errors import LightdomeError
from lightdome.maps.images import read_image
from lightdome.sampling.samples import Samples


@pytest.mark.slow
def test_damaged_files_are_read_or_refused(tmp_path: Path) -> None:
    counts, failures = fuzz.fuzz(400, 0, tmp_path / "failures")
    assert not failures, "\n".join(failures)
    # Damage that no file survives, or that no reader notices, would test nothing.
    for suffix in (".pfm", ".hdr", ".exr", ".npz"):
        assert counts[f"{suffix} read"] >= 1
        assert counts[f"{suffix} refused"] >= 30


def test_the_files_are_valid_before_they_are_damaged(tmp_path: Path) -> None:
    for name, content in fuzz.corpus().items():
        (tmp_path / name).write_bytes(content)
        verdict = fuzz.read(tmp_path / name)
        refused = {"deep.exr": "is a deep image"} | ({"chroma.exr": "luminance-chroma"} if CHROMA_IS_HIDDEN else {})
        assert refused[name] in verdict if name in refused else verdict == "read", verdict


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # casts that overflow
def test_every_array_can_be_damaged_twice_and_stays_small() -> None:
    rng = np.random.default_rng(0)
    for _ in range(30):
        for name, array in fuzz.arrays().items():
            for mutation in fuzz.ARRAY_MUTATIONS:
                result = mutation(rng, fuzz.other_type(rng, array))
                content = result if isinstance(result, bytes) else fuzz.npy(result)
                assert len(content) < 2**26, (name, mutation)


@pytest.mark.parametrize(
    ("program", "failure", "seconds"),
    [
        ("input(); input()", "did not finish", 0.1),
        ("import os; input(); os.abort()", "status -6", fuzz.SECONDS),
        (
            "import sys; input(); print('chatter', file=sys.stderr); print('[0, 0, \"read\"]')",
            "chatter",
            fuzz.SECONDS,
        ),
        ("input(); print('[0, 1000, \"read\"]')", "1000 MiB", fuzz.SECONDS),
    ],
)
def test_a_reader_that_hangs_crashes_chatters_or_bloats_is_found(
    tmp_path: Path, program: str, failure: str, seconds: float
) -> None:
    with (tmp_path / "errors").open("w") as errors:
        process = subprocess.Popen(
            [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, text=True
        )
        verdict = fuzz.Worker(process, tmp_path / "errors").read(tmp_path, seconds)
        process.communicate()
    assert verdict.startswith("failed")
    assert failure in verdict


def test_what_is_left_on_disk_is_found(tmp_path: Path) -> None:
    def leave(worker: fuzz.Worker, path: Path) -> str:
        path.with_suffix(".left").touch()
        return "read"

    _, failures = fuzz.fuzz(1, 0, tmp_path / "failures", read=leave)
    assert "on disk" in failures[0]
    assert len(list((tmp_path / "failures").iterdir())) == 1


def test_a_constant_map_packs_into_few_bytes_and_is_read(tmp_path: Path) -> None:
    spec = oiio.ImageSpec(2048, 1024, 3, oiio.HALF)
    spec.attribute("compression", "dwab")
    spec.tile_width = spec.tile_height = 1024
    file = oiio.ImageOutput.create("map.exr")
    assert file.open(str(tmp_path / "map.exr"), spec)
    assert file.write_image(np.full((1024, 2048, 3), 0.5, np.float32))
    file.close()
    assert 3000 * (tmp_path / "map.exr").stat().st_size < 2048 * 1024 * 3
    assert np.abs(read_image(tmp_path / "map.exr") - 0.5).max() < 0.01


def test_tiles_that_reach_far_out_of_the_image_cost_no_memory(tmp_path: Path) -> None:
    content = fuzz.corpus()["zip_half_tiles.exr"]
    size = content.index(b"tiles\0tiledesc\0") + 19
    (tmp_path / "map.exr").write_bytes(content[:size] + (2**20).to_bytes(4, "little") + content[size + 4 :])
    with pytest.raises(LightdomeError, match="tiles of 1048576 x 32 pixels"):
        read_image(tmp_path / "map.exr")


def test_zeros_that_inflate_to_more_than_the_file_can_mean_are_refused(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    bombs = {name: fuzz.bomb(rng, array) for name, array in fuzz.arrays().items()}
    (tmp_path / "bomb.npz").write_bytes(fuzz.npz(bombs, compression=8))
    with pytest.raises(LightdomeError, match="not as long as it says"):
        Samples.load(tmp_path / "bomb.npz")


def test_another_kind_of_image_under_a_map_s_name_is_refused(tmp_path: Path) -> None:
    (tmp_path / "photo.pfm").write_bytes(b"P6\n1 1\n255\n\1\2\3")
    with pytest.raises(LightdomeError, match="another kind"):
        read_image(tmp_path / "photo.pfm")


def test_the_scripts_refuse_in_one_line_and_leave_nothing(script: Script, tmp_path: Path) -> None:
    pickled = fuzz.arrays() | {"direction": np.full((50, 3), None)}
    (tmp_path / "pickled.npz").write_bytes(fuzz.npz(pickled))
    (tmp_path / "huge.pfm").write_bytes(b"PF\n999999999 999999999\n-1\n")
    files = fuzz.corpus()
    (tmp_path / "negative.hdr").write_bytes(files["flat.hdr"].replace(b"-Y 37", b"-Y -37"))
    (tmp_path / "no_text.exr").write_bytes(files["zip_half_lines.exr"].replace(b"chlist", b"\xff\x80list", 1))
    (tmp_path / "temporary").mkdir()
    for name in ("pickled.npz", "huge.pfm", "negative.hdr", "no_text.exr"):
        command = ("part3_shade",) if name == "pickled.npz" else ("part2_sample", "--map")
        result = script(*command, tmp_path / name, "--out", tmp_path / "out", TMPDIR=str(tmp_path / "temporary"))
        fails_in_one_line(result, name)
        assert not list(tmp_path.glob("out/*"))
        assert not list((tmp_path / "temporary").iterdir())


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_nothing_waits_for_a_pipe(script: Script, tmp_path: Path) -> None:
    for name, command in (("map.exr", ("part2_sample", "--map")), ("samples.npz", ("part3_shade",))):
        os.mkfifo(tmp_path / name)
        fails_in_one_line(script(*command, tmp_path / name, "--out", tmp_path / "out"), name)
