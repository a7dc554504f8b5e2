"""Samples of a map left in its file are those of the map in memory, to the last bit."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import fuzz
import numpy as np
import OpenImageIO as oiio
import pytest
from helpers import CHROMA_IS_HIDDEN, ROOT, Script, command_line, fails_in_one_line, stiff_radiance
from image_bytes import IMAGE, hdr, pfm
from lightdome.errors import LightdomeError
from lightdome.maps.envmap import EnvironmentMap, Replaced
from lightdome.maps.images import ImageRows, read_image, write_image
from lightdome.opencl.device import Device
from lightdome.sampling.distribution import build_distribution
from lightdome.sampling.samples import SEQUENCES, Samples
from lightdome.sampling.streaming import sample_file


def shifted_exr(path: Path, radiance: np.ndarray, x: int, y: int, tile: int) -> Path:
    """An EXR whose windows begin at (x, y)."""
    spec = fuzz.image_spec(radiance, "none", oiio.FLOAT, tile)
    spec.x, spec.y, spec.full_x, spec.full_y = x, y, x, y
    file = oiio.ImageOutput.create(str(path))
    assert file.open(str(path), spec), file.geterror()
    assert file.write_image(radiance), file.geterror()
    file.close()
    return path


def by_rows(path: Path, rows: np.ndarray, batch: int | None) -> np.ndarray:
    """The given rows as :class:`ImageRows` reads them, in their order."""
    image = ImageRows(path, batch)
    parts = dict[int, np.ndarray]()
    for numbers, pixels in image.read(rows):
        assert len(numbers) <= image.batch
        assert pixels.shape == (len(numbers), image.width, 3)
        assert pixels.dtype == np.float32
        assert pixels.flags.c_contiguous
        parts.update(zip(numbers.tolist(), pixels, strict=True))
    return np.stack([parts[row] for row in rows.tolist()])


FILES = {name: content for name, content in fuzz.corpus().items() if not name.endswith("npz") and name != "deep.exr"}
if CHROMA_IS_HIDDEN:
    del FILES["chroma.exr"]
FILES |= {
    "up.hdr": hdr(IMAGE[::-1], b"+Y 2 +X 4"),
    "left.hdr": hdr(IMAGE[:, ::-1], b"-Y 2 -X 4"),
    "upside_down.hdr": hdr(IMAGE[::-1, ::-1], b"+Y 2 -X 4"),
    "columns.hdr": hdr(IMAGE.swapaxes(0, 1), b"+X 4 -Y 2"),
    "comment.pfm": pfm(IMAGE).replace(b"\n", b"\n# made by hand\n", 1),
    "doubled.pfm": pfm(IMAGE).replace(b"-1.0", b"-2.0"),
    "in_one_line.pfm": pfm(IMAGE).replace(b"\n", b" ", 3),
    "whole_number.pfm": pfm(IMAGE, ">").replace(b"1.0", b"1"),
}


@pytest.mark.parametrize("name", FILES)
def test_rows_of_every_format_and_layout_are_those_of_the_image(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(FILES[name])
    image = read_image(path)
    height, width = image.shape[:2]
    rows = np.arange(height)
    for batch in (1, 3, None):
        assert (ImageRows(path, batch).height, ImageRows(path, batch).width) == (height, width)
        np.testing.assert_array_equal(by_rows(path, rows, batch), image)
        for some in (rows[-1:], rows[::2], rows[(rows % 16 > 2) & (rows != 20)]):
            if len(some):
                np.testing.assert_array_equal(by_rows(path, some, batch), image[some])


@pytest.mark.parametrize("tile", [0, 16])
def test_windows_need_not_begin_at_the_origin(tmp_path: Path, tile: int) -> None:
    radiance = stiff_radiance(21, 43)
    path = shifted_exr(tmp_path / "map.exr", radiance, x=5, y=-7, tile=tile)
    np.testing.assert_array_equal(by_rows(path, np.arange(21), 3), radiance)


@pytest.mark.parametrize(("name", "damaged"), [("zip_half_lines.exr", 20), ("zip_half_tiles.exr", 33)])
def test_rows_that_are_not_asked_for_are_not_read(tmp_path: Path, name: str, damaged: int) -> None:
    path = tmp_path / name
    content = FILES[name]
    path.write_bytes(content)
    rows = np.array([0, 3, 15, 36] if damaged == 20 else [0, 3, 31])  # from packs other than the damaged one
    expected = read_image(path)[rows]
    at = len(content) * damaged // 37
    path.write_bytes(content[:at] + bytes(300) + content[at + 300 :])
    np.testing.assert_array_equal(by_rows(path, rows, None), expected)
    with pytest.raises(LightdomeError, match="damaged or truncated"):
        by_rows(path, np.append(rows[:2], damaged), None)


@pytest.mark.parametrize(("name", "first"), [("map.hdr", [0, 1, 2]), ("up.hdr", [2, 1, 0]), ("map.pfm", [2, 1, 0])])
def test_batches_come_in_the_order_of_the_file(tmp_path: Path, name: str, first: list[int]) -> None:
    image = np.resize(IMAGE, (3, 4, 3))
    contents = {"map.hdr": hdr(image, b"-Y 3 +X 4"), "up.hdr": hdr(image[::-1], b"+Y 3 +X 4"), "map.pfm": pfm(image)}
    (tmp_path / name).write_bytes(contents[name])
    assert [int(rows[0]) for rows, _ in ImageRows(tmp_path / name, batch=1).read(np.arange(3))] == first


@pytest.mark.parametrize("name", ["little.pfm", "grey.pfm", "flat.hdr", "rle.hdr", "zip_half_lines.exr", "columns.hdr"])
def test_a_truncated_file_is_refused_in_one_line(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    content = FILES[name]
    for length in {0, 1, 11, len(content) // 2, len(content) - 9, len(content) - 1}:
        path.write_bytes(content[:length])
        with pytest.raises(LightdomeError) as error:
            by_rows(path, np.arange(ImageRows(path).height), None)
        assert str(path) in str(error.value)
        assert "\n" not in str(error.value)


def test_a_file_that_shrinks_while_it_is_read_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "little.pfm"
    path.write_bytes(FILES["little.pfm"])
    batches = ImageRows(path, batch=1).read(np.arange(37))
    next(batches)
    os.truncate(path, 3000)
    with pytest.raises(LightdomeError, match="ends too early"):
        list(batches)


def assert_same(drawn: Samples, expected: Samples) -> None:
    for name in ("direction", "radiance", "probability", "pixel"):
        one, other = getattr(drawn, name), getattr(expected, name)
        assert one.dtype == other.dtype
        assert one.tobytes() == other.tobytes(), name
    assert (drawn.map_shape, drawn.sequence, drawn.seed) == (expected.map_shape, expected.sequence, expected.seed)
    assert (drawn.version, drawn.within) == (expected.version, expected.within)


@pytest.mark.parametrize("batch", [1, 3, None])
@pytest.mark.parametrize("name", ["map.pfm", "map.exr", "up.hdr"])
def test_samples_are_those_of_the_map_in_memory(device: Device, tmp_path: Path, name: str, batch: int | None) -> None:
    path = tmp_path / name
    if path.suffix == ".hdr":
        path.write_bytes(FILES[name])
    else:
        write_image(path, stiff_radiance(21, 43))
    distribution = build_distribution(device, EnvironmentMap.read(path))
    counts = [1, 2000, 7]  # many per pixel, so that searches are guided, and few
    for sequence in SEQUENCES:
        sets = sample_file(device, ImageRows(path, batch), counts, 2**40 + 1, sequence)
        for count, samples in zip(counts, sets, strict=True):
            assert_same(samples, distribution.sample(count, 2**40 + 1, sequence))
        sets = sample_file(device, ImageRows(path, batch), counts, 5, sequence, within="pixel")
        for count, samples in zip(counts, sets, strict=True):
            assert_same(samples, distribution.sample(count, 5, sequence, within="pixel"))


@pytest.mark.parametrize("exponent", [-110, 90])
def test_a_map_at_an_end_of_the_range_is_scaled_as_in_memory(device: Device, tmp_path: Path, exponent: int) -> None:
    path = tmp_path / "map.pfm"
    write_image(path, stiff_radiance(21, 43) * np.float32(2.0**exponent))
    distribution = build_distribution(device, EnvironmentMap.read(path))
    assert distribution.map.scale != 1
    assert_same(sample_file(device, ImageRows(path, 3), [500])[0], distribution.sample(500))


def test_bad_pixels_are_refused_with_the_words_for_the_map_in_memory(device: Device, tmp_path: Path) -> None:
    radiance = stiff_radiance(21, 43)
    radiance[4, 9] = -1
    radiance[4, 8, 2] = np.inf
    radiance[5, 2, 1] = np.nan
    radiance[19, 1] = np.nan, -1, 3
    path = tmp_path / "bad.pfm"  # bottom up: the first bad pixel is not the first one read
    write_image(path, radiance)
    with pytest.raises(LightdomeError) as expected:
        EnvironmentMap.read(path)
    with pytest.raises(LightdomeError, match=re.escape(str(expected.value))):
        sample_file(device, ImageRows(path, 3), [5])
    for way in (True, "black", "clamp"):
        envmap = EnvironmentMap.read(path, sanitize=way)
        reports: list[Replaced] = []
        drawn = sample_file(device, ImageRows(path, 3), [500], sanitize=way, report=reports.append)[0]
        assert_same(drawn, build_distribution(device, envmap).sample(500))
        assert [report.note for report in reports] == [envmap.replaced.note]


def test_a_half_float_sun_is_clamped_as_in_memory(device: Device) -> None:
    path = ROOT / "tests" / "maps" / "field_cases" / "exr_half_infinite_sun.exr"
    drawn = sample_file(device, ImageRows(path), [300], sanitize="clamp")[0]
    assert drawn.radiance.max() == 65504
    assert_same(drawn, build_distribution(device, EnvironmentMap.read(path, sanitize="clamp")).sample(300))


@pytest.mark.parametrize("batch", [1, 4, None])
@pytest.mark.parametrize("name", ["map.pfm", "up.hdr", "columns.hdr", "zip_half_tiles.exr"])
def test_flipped_rows_give_the_samples_of_the_flipped_map(
    device: Device, tmp_path: Path, name: str, batch: int | None
) -> None:
    path = tmp_path / name
    if name == "map.pfm":
        write_image(path, stiff_radiance(21, 43))
    else:
        path.write_bytes(FILES[name])
    upright = EnvironmentMap.read(path)
    flipped = build_distribution(device, EnvironmentMap(upright.radiance[::-1])).sample(400)
    assert_same(sample_file(device, ImageRows(path, batch, flip=True), [400])[0], flipped)


def test_reordered_columns_give_the_samples_of_the_rolled_and_mirrored_map(device: Device, tmp_path: Path) -> None:
    radiance = stiff_radiance(21, 43)
    write_image(tmp_path / "map.pfm", radiance)
    columns = np.roll(np.arange(43), 5)[::-1]
    image = ImageRows(tmp_path / "map.pfm", 4, flip=True)
    image.reorder(columns)
    expected = build_distribution(device, EnvironmentMap(radiance[::-1, columns])).sample(400)
    assert_same(sample_file(device, image, [400])[0], expected)
    for wrong in (np.arange(42), np.arange(43) - 1, np.zeros(43), np.arange(43) + 0.5):
        with pytest.raises(LightdomeError, match=r"^columns must [^\n]*$"):
            image.reorder(wrong)


def test_what_cannot_be_drawn_is_refused(device: Device, tmp_path: Path) -> None:
    path = tmp_path / "black.pfm"
    write_image(path, np.zeros((4, 8, 3), np.float32))
    for arguments, message in (
        (([5],), "black everywhere"),
        (([5, 0],), "the number of samples must be a whole number"),
        (([5], 0, "magic"), "unknown sequence"),
        (([5], -1), "a seed must be a whole number"),
    ):
        with pytest.raises(LightdomeError, match=message):
            sample_file(device, ImageRows(path), *arguments)


def test_a_file_is_read_twice_however_many_sets_are_drawn(device: Device, tmp_path: Path) -> None:
    path = tmp_path / "map.exr"
    write_image(path, stiff_radiance(210, 43))
    read: list[int] = []

    class Counted(ImageRows):
        def read(self, rows: np.ndarray) -> object:
            read.append(len(rows))
            return super().read(rows)

    sets = sample_file(device, Counted(path), [3, 5, 9])
    assert read == [210, len(np.unique(np.concatenate([samples.pixel[:, 1] for samples in sets])))]


def sparse_pfm(path: Path, height: int, width: int) -> Path:
    """A map that is black except for two pixels, and takes almost no space on the disk."""
    head = b"PF\n%d %d\n-1.0\n" % (width, height)
    with path.open("wb") as file:
        file.write(head)
        for y, x in ((1, 2), (height - 3, width - 1)):
            file.seek(len(head) + 12 * ((height - 1 - y) * width + x))
            file.write(np.array([1, 2, 3], "<f4").tobytes())
        file.truncate(len(head) + 12 * height * width)
    return path


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "wait4"), reason="needs the peak memory of a process")
def test_memory_is_for_bands_and_not_for_the_map(tmp_path: Path) -> None:
    path = sparse_pfm(tmp_path / "large.pfm", 4096, 8192)  # 384 MiB
    # A process inherits the peak of its parent, so a small process starts it.
    small = (
        "import resource, subprocess, sys\n"
        "subprocess.run(sys.argv[1:], check=True, stdout=subprocess.DEVNULL)\n"
        "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)\n"
    )

    def peak(*arguments: str | Path) -> float:
        """Peak memory in MiB."""
        command = command_line("part2_sample", "--samples-only", *arguments)
        return int(subprocess.check_output([sys.executable, "-c", small, *command], text=True)) / 1024

    tiny = peak("--map", sparse_pfm(tmp_path / "tiny.pfm", 8, 16), "--out", tmp_path)  # Python and OpenCL alone
    assert peak("--map", path, "--out", tmp_path) < tiny + 250
    samples = Samples.load(tmp_path / "samples_1024.npz")
    assert {(2, 1), (8191, 4093)} >= set(map(tuple, samples.pixel.tolist()))
    np.testing.assert_array_equal(samples.radiance, np.tile(np.float32((1, 2, 3)), (1024, 1)))


def test_part_2_draws_the_same_samples_without_pictures(run_here: Script, tmp_path: Path) -> None:
    write_image(tmp_path / "map.exr", stiff_radiance(21, 43))
    arguments = ("part2_sample", "--map", tmp_path / "map.exr", "--counts", 9, 5, "--sequence", "sobol")
    arguments = (*arguments, "--within", "pixel", "--out")
    result = run_here(*arguments, tmp_path / "only", "--samples-only")
    assert result.returncode == 0, result.stderr
    assert "note: the map is 43 x 21" in result.stderr
    assert {path.name for path in (tmp_path / "only").iterdir()} == {"samples_5.npz", "samples_9.npz", "settings.json"}
    assert run_here(*arguments, tmp_path / "all").returncode == 0
    for name in ("samples_5.npz", "samples_9.npz"):
        assert (tmp_path / "only" / name).read_bytes() == (tmp_path / "all" / name).read_bytes()
        assert Samples.load(tmp_path / "all" / name).within == "pixel"
    assert json.loads((tmp_path / "all" / "settings.json").read_text())["options"]["within"] == "pixel"


def test_a_map_that_is_too_large_is_refused_with_the_option_that_helps(script: Script, tmp_path: Path) -> None:
    path = sparse_pfm(tmp_path / "large.pfm", 2**14, 2**16)
    result = script("part2_sample", "--map", path, "--out", tmp_path / "out", POCL_MEMORY_LIMIT="1")
    fails_in_one_line(result, "65536 x 16384 map", "--samples-only")
    assert not list((tmp_path / "out").iterdir())


@pytest.mark.slow
def test_points_on_the_steps_between_rows_find_the_rows_of_the_map_in_memory(device: Device, tmp_path: Path) -> None:
    # Enough rows and samples that a few dozen points lie exactly on a step.
    write_image(tmp_path / "map.pfm", np.ones((2**16, 1, 3), np.float32))
    image = ImageRows(tmp_path / "map.pfm")
    (samples,) = sample_file(device, image, [2**20], 3)
    pixel, _ = build_distribution(device, EnvironmentMap.read(image.path)).sample_pixels(2**20, 3)
    np.testing.assert_array_equal(samples.pixel, pixel)
