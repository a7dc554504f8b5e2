"""Radiance HDR: every orientation, header and packing of scan lines, compared with bytes written by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers import Script
from lightdome.errors import LightdomeError
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.images import ImageRows, read_image

HEIGHT, WIDTH = 9, 11
RGBE = np.random.default_rng(2).integers(0, 256, (HEIGHT, WIDTH, 4), np.uint8)
RGBE[..., 3] = 120 + RGBE[..., 3] % 16
RGBE[2:6] = RGBE[3, 0]  # a run to pack
RGBE[6, 4:8] = RGBE[6, 4]
RGBE[..., 0] |= 2  # so that no pixel is a run (1, 1, 1, n)
FORMAT = b"FORMAT=32-bit_rle_rgbe\n"
# For each size line, the picture as it is stored: scan lines of pixels, made from the upright picture.
ORIENTATIONS = {
    "-Y +X": lambda p: p,
    "-Y -X": lambda p: p[:, ::-1],
    "+Y +X": lambda p: p[::-1],
    "+Y -X": lambda p: p[::-1, ::-1],
    "+X -Y": lambda p: p.swapaxes(0, 1),
    "+X +Y": lambda p: p[::-1].swapaxes(0, 1),
    "-X -Y": lambda p: p[:, ::-1].swapaxes(0, 1),
    "-X +Y": lambda p: p[::-1, ::-1].swapaxes(0, 1),
}


def radiance(rgbe: np.ndarray) -> np.ndarray:
    return np.ldexp(rgbe[..., :3].astype(np.float64), rgbe[..., 3:].astype(int) - 136).astype(np.float32)


def packed(line: np.ndarray) -> bytes:
    """By component, in runs and in literal stretches."""
    result = b"\2\2" + len(line).to_bytes(2, "big")
    for component in line.T:
        values, at = component.tobytes(), 0
        while at < len(values):
            run = len(values[at:]) - len(values[at:].lstrip(values[at : at + 1]))
            count = min(run if run > 2 else 2, len(values) - at, 127)
            result += bytes([128 + count, values[at]]) if run > 2 else bytes([count]) + values[at : at + count]
            at += count
    return result


def plain(line: np.ndarray) -> bytes:
    return line.tobytes()


def old_runs(line: np.ndarray) -> bytes:
    """Each pixel, then run pixels with the number of repetitions, 8 bits in each, the lowest first."""
    result, at = b"", 0
    while at < len(line):
        end = at
        while end < len(line) and (line[end] == line[at]).all():
            end += 1
        result += line[at].tobytes()
        more = end - at - 1
        while more:
            result += bytes([1, 1, 1, more % 256])
            more //= 256
        at = end
    return result


def hdr(rgbe: np.ndarray, header: bytes = FORMAT, axes: str = "-Y +X", pack: object = packed) -> bytes:
    lines = ORIENTATIONS[axes](rgbe)
    first, second = axes.split()
    size = f"{first} {lines.shape[0]} {second} {lines.shape[1]}\n".encode()
    packs = pack if isinstance(pack, list) else [pack]
    body = b"".join(packs[i % len(packs)](line) for i, line in enumerate(lines))
    return b"#?RADIANCE\n" + header + b"\n" + size + body


def assert_read(path: Path, content: bytes, expected: np.ndarray) -> None:
    """Assert what is read as a whole, by rows, and by some of the rows."""
    path.write_bytes(content)
    np.testing.assert_array_equal(read_image(path), expected)
    rows = ImageRows(path, batch=2)
    assert (rows.height, rows.width) == expected.shape[:2]
    for wanted in (np.arange(rows.height), np.arange(rows.height)[1::3]):
        for numbers, pixels in rows.read(wanted):
            np.testing.assert_array_equal(pixels, expected[numbers])


@pytest.mark.parametrize("axes", ORIENTATIONS)
@pytest.mark.parametrize("pack", [packed, plain])
def test_every_orientation_gives_the_same_picture(tmp_path: Path, axes: str, pack: object) -> None:
    assert_read(tmp_path / "map.hdr", hdr(RGBE, axes=axes, pack=pack), radiance(RGBE))


@pytest.mark.parametrize(
    "pack",
    [plain, old_runs, [old_runs, packed], [packed, old_runs], [packed, plain, old_runs], [packed] * 4 + [old_runs]],
)
def test_every_packing_gives_the_same_picture(tmp_path: Path, pack: object) -> None:
    assert_read(tmp_path / "map.hdr", hdr(RGBE, pack=pack), radiance(RGBE))


@pytest.mark.parametrize(
    ("width", "pack"), [(1, plain), (7, old_runs), (8, packed), (32767, packed), (32768, old_runs)]
)
def test_narrow_and_wide_lines_are_read(tmp_path: Path, width: int, pack: object) -> None:
    lines = np.repeat(RGBE[:2], -(-width // WIDTH), axis=1)[:, :width]
    lines[1] = lines[1, 0]  # a run of 2^15 needs two run pixels, 255 and 127 times 256
    assert_read(tmp_path / "map.hdr", hdr(lines, pack=pack), radiance(lines))


def test_runs_that_follow_each_other_count_256_times_as_much(tmp_path: Path) -> None:
    lines = np.broadcast_to(np.array([9, 8, 7, 129], np.uint8), (2, 1 + 2 + 256 * 3, 4))
    body = bytes([9, 8, 7, 129, 1, 1, 1, 2, 1, 1, 1, 3]) * 2
    assert_read(tmp_path / "map.hdr", b"#?RADIANCE\n\n-Y 2 +X 771\n" + body, radiance(lines))


def test_a_grey_power_of_two_is_no_run(tmp_path: Path) -> None:
    grey = RGBE.copy()
    grey[2:, 3:] = [128, 128, 128, 129]
    assert_read(tmp_path / "map.hdr", hdr(grey), radiance(grey))


@pytest.mark.parametrize(
    ("header", "divisor"),
    [
        (b"EXPOSURE=2\n", 2),
        (b"EXPOSURE= 2.0e+00 \n", 2),
        (b"EXPOSURE = 2.\n", 2),
        (b"Exposure=\t+.2e1\n", 2),
        (b"EXPOSURE=2\r\n", 2),
        (b"EXPOSURE=2\nEXPOSURE=0.25\nEXPOSURE=3e0\n", 1.5),
        (b"COLORCORR=1 2 4\n", (1, 2, 4)),
        (b"COLORCORR= 1.0  2.0 4.0\nEXPOSURE=0.5\nCOLORCORR=3 1 1\n", (1.5, 1, 2)),
        (b"\tEXPOSURE=2\n EXPOSURE=2\n# EXPOSURE=2\npfilt -e EXPOSURE=2\n", 1),  # from earlier pictures, and other text
        (b"EXPOSURE=1\nCOLORCORR=1 1 1\n", 1),
        (b"EXPOSURE=4\nEXPOSURE=.25\n", 1),
    ],
)
@pytest.mark.parametrize("pack", [packed, plain])
def test_exposure_and_colour_correction_are_divided_out_and_reported(
    tmp_path: Path, header: bytes, divisor: object, pack: object
) -> None:
    path = tmp_path / "map.hdr"
    expected = radiance(RGBE).astype(np.float64) / divisor
    assert_read(path, hdr(RGBE, header + FORMAT, pack=pack), expected.astype(np.float32))
    notes = ImageRows(path).notes
    assert EnvironmentMap.read(path).notes == notes
    assert len(notes) == np.any(np.array(divisor) != 1)
    assert all("divided by" in note for note in notes)


def test_scripts_say_that_they_divide(tmp_path: Path, run_here: Script) -> None:
    (tmp_path / "map.hdr").write_bytes(hdr(RGBE, b"EXPOSURE=2\n"))
    for more in ((), ("--samples-only",)):
        result = run_here(
            "part2_sample", "--map", tmp_path / "map.hdr", "--counts", 3, "--out", tmp_path / "out", *more
        )
        assert result.returncode == 0, result.stderr
        assert "divided by 2" in result.stderr


@pytest.mark.parametrize(
    "content",
    [
        hdr(RGBE, b""),
        hdr(RGBE, b"SOFTWARE=anything\n"),
        hdr(RGBE, b"FORMAT = 32-bit_rle_rgbe\n"),
        hdr(RGBE, b"FORMAT=  32-bit_rle_rgbe \n"),
        hdr(RGBE, b"format=32-BIT_RLE_RGBE\n"),
        hdr(RGBE, b"# a comment\n" * 700 + FORMAT + b"VIEW=x\n" * 700),
        hdr(RGBE, b"x" * 5000 + b"\n" + FORMAT),
        hdr(RGBE, "# \N{COPYRIGHT SIGN}\n".encode("latin-1") + FORMAT),
        hdr(RGBE).replace(b"RADIANCE", b"RGBE", 1),
        hdr(RGBE).replace(b"RADIANCE", b"AUTOPANO", 1),
        hdr(RGBE).replace(b"\n", b"\r\n", 4),
        hdr(RGBE).replace(b"-Y 9 +X 11", b"-Y  9  +X 11 "),
        hdr(RGBE) + b"more",
    ],
)
def test_unusual_but_sound_headers_are_read(tmp_path: Path, content: bytes) -> None:
    assert_read(tmp_path / "map.hdr", content, radiance(RGBE))


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (hdr(RGBE, b"FORMAT=32-bit_rle_xyze\n"), "XYZ.*ra_xyze"),
        (hdr(RGBE, b"FORMAT=Radiance_spectra\n"), "got 'Radiance_spectra'"),
        (hdr(RGBE, b"FORMAT=\n"), "got ''"),
        (hdr(RGBE, FORMAT + b"\n"), "expected a size .*, got ''"),
        (hdr(RGBE, FORMAT + b"x" * 2**20), "not end.* within the first MiB"),
        (hdr(RGBE, b"EXPOSURE=0\n"), "bad header line 'EXPOSURE=0'"),
        (hdr(RGBE, b"EXPOSURE=-1\n"), "bad header line"),
        (hdr(RGBE, b"EXPOSURE=nan\n"), "bad header line"),
        (hdr(RGBE, b"EXPOSURE=1e999\n"), "bad header line"),
        (hdr(RGBE, b"EXPOSURE=\n"), "bad header line"),
        (hdr(RGBE, b"EXPOSURE=1,5\n"), "bad header line"),
        (hdr(RGBE, b"COLORCORR=1 1\n"), "bad header line"),
        (hdr(RGBE, b"EXPOSURE=1e300\nEXPOSURE=1e300\n"), "range of numbers"),
        (b"#?RADIANCE\n" + FORMAT, "not end"),
        (b"#?RADIANCE\n" + FORMAT + b"\n-Y 9 +X", "not end"),
        (b"#?RADIANCE\n" + FORMAT + b"\n-Y 9 +Y 11\n", "expected a size"),
        (b"#?RADIANCE\n" + FORMAT + b"\n9 11\n", "expected a size"),
        (b"#?RADIANCE\n" + FORMAT + b"\n-Y 0 +X 11\n", "0 pixels"),
        (hdr(RGBE).replace(b"\2\2\0\x0b", b"\2\2\0\x0c", 1), "another length"),
        (hdr(RGBE)[:-1], "too early"),
        (hdr(RGBE, pack=old_runs)[:-1], "too early"),
        (b"#?RADIANCE\n\n-Y 1 +X 2\n" + bytes([1, 1, 1, 2, 1, 1, 1, 2]), "begins with a run"),
        (b"#?RADIANCE\n\n-Y 1 +X 4\n" + bytes([9, 9, 9, 130, 1, 1, 1, 9, 0, 0, 0, 0, 0, 0, 0, 0]), "exceeds"),
        (b"#?RADIANCE\n\n-Y 1 +X 9\n" + b"\2\2\0\x09" + bytes([128 + 10, 5]) * 4, "exceeds"),
        (b"#?RADIANCE\n\n-Y 1 +X 9\n" + b"\2\2\0\x09" + bytes(40), "length 0"),
    ],
)
def test_what_cannot_be_read_is_refused_for_the_right_reason(tmp_path: Path, content: bytes, reason: str) -> None:
    (tmp_path / "map.hdr").write_bytes(content)
    with pytest.raises(LightdomeError, match=reason):
        read_image(tmp_path / "map.hdr")


def test_a_gamma_is_reported_but_not_undone(tmp_path: Path) -> None:
    assert_read(tmp_path / "map.hdr", hdr(RGBE, b"GAMMA=2.2\n"), radiance(RGBE))
    assert "GAMMA=2.2" in ImageRows(tmp_path / "map.hdr").notes[0]
