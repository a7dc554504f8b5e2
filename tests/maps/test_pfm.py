"""PFM: magic, header and size are checked against each other, and values keep their bits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from lightdome.errors import LightdomeError
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.images import ImageRows, read_image

IMAGE = np.random.default_rng(3).random((3, 5, 4), np.float32)
COLOUR = IMAGE[..., :3]
LITTLE, BIG = (COLOUR[::-1].astype(f"{order}f4").tobytes() for order in "<>")
FOUR = IMAGE[::-1].astype("<f4").tobytes()


def read_both_ways(path: Path, content: bytes) -> np.ndarray:
    path.write_bytes(content)
    image = read_image(path)
    rows = ImageRows(path, batch=2)
    assert (rows.height, rows.width) == image.shape[:2]
    for numbers, pixels in rows.read(np.arange(rows.height)):
        np.testing.assert_array_equal(pixels, image[numbers])
    return image


@pytest.mark.parametrize(
    "content",
    [
        b"PF\n5 3\n-1.0\n" + LITTLE,
        b"PF\n5 3\n1.0\n" + BIG,
        b"PF\n5 3\n+1\n" + BIG,
        b"PF\n5 3\n-1e0\n" + LITTLE,
        b"PF\n5 3\n-10.0E-1\n" + LITTLE,
        b"PF\n5 3\n-.1e+1\n" + LITTLE,
        b"PF\r\n5 3\r\n-1.0\r\n" + LITTLE,
        b"PF\r5 3\r-1.0\r" + LITTLE,
        b"PF 5 3 -1.0 " + LITTLE,
        b"PF\n5\n3\n-1.0\n" + LITTLE,
        b"PF\n  5\t 3  \n -1.0  \n" + LITTLE,
        b"PF # colour\n# made by hand\n5 3 # size\n-1.0 # little endian\n" + LITTLE,
        b"PF\n5 3\n-1.0\n# made by hand\n" + LITTLE,
        b"PF\n#" + b"x" * 3000 + b"\n5 3\n-1.0\n" + LITTLE,
        b"PF4\n5 3\n-1.0\n" + FOUR,
    ],
)
def test_sound_headers_are_read(tmp_path: Path, content: bytes) -> None:
    np.testing.assert_array_equal(read_both_ways(tmp_path / "map.pfm", content), COLOUR)


def test_values_keep_their_bits(tmp_path: Path) -> None:
    values = np.array([[0, -0.0, np.inf, -np.inf, 1e-45, 3e38, -1]], np.float32)
    image = read_both_ways(tmp_path / "map.pfm", b"Pf\n7 1\n-1\n" + values.tobytes())
    assert image.tobytes() == np.repeat(values[..., None], 3, axis=2).tobytes()


def test_the_scale_multiplies_and_is_reported(tmp_path: Path) -> None:
    image = read_both_ways(tmp_path / "map.pfm", b"PF\n5 3\n-2.5\n" + LITTLE)
    np.testing.assert_array_equal(image, COLOUR * np.float32(2.5))
    assert "scale in its header, 2.5" in EnvironmentMap.read(tmp_path / "map.pfm").notes[0]


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        *((b"PF\n5 3\n%s\n" % scale + LITTLE, "bad scale") for scale in (b"0", b"-0.0", b"nan", b"-inf", b"1e99")),
        *((b"PF\n5 3\n%s\n" % scale + LITTLE, "bad scale") for scale in (b"1e-99", b"one", b"0x1", b"--1", b"1_0")),
        (b"PF4\n5 3\n-1\n" + LITTLE, "take 240 bytes"),
        (b"PF5\n5 3\n-1\n" + LITTLE, "unknown kind of PFM file PF5"),
        (b"PFx\n5 3\n-1\n" + LITTLE, "unknown kind of PFM file PFx"),
        (b"PF\n-5 3\n-1\n" + LITTLE, "bad size -5 x 3"),
        (b"PF\n5.0 3\n-1\n" + LITTLE, r"bad size 5\.0 x 3"),
        (b"PF\n0 3\n-1\n" + LITTLE, "0 x 3 pixels"),
        (b"PF\n5 3\n-1\n" + LITTLE[:-1], "take 180 bytes"),
        (b"PF\n5 3\n-1\n" + LITTLE + b"\n", "take 180 bytes"),
        (b"PF\n5 2\n-1\n" + LITTLE, "take 120 bytes"),
        (b"Pf\n5 3\n-1\n" + LITTLE, "take 60 bytes"),
        (b"PF\n5 3\n-1\n\n\n" + LITTLE, "take 180 bytes"),
        # The header ends in CRLF, or in a space and LF: the LF does not belong to a pixel.
        (b"PF\r\n5 3\r\n-1\r\n" + LITTLE[:-1], "take 180 bytes"),
        (b"PF\n5 3\n-1 \n" + LITTLE[:-1], "take 180 bytes"),
        (b"PF\n5 3\n", "begin with PF"),
        (b"PF\n# no end", "begin with PF"),
        (b"PF\n60000 60000\n-1\n" + LITTLE, "60000 x 60000"),
    ],
)
def test_what_does_not_agree_is_refused_before_a_value_is_used(tmp_path: Path, content: bytes, reason: str) -> None:
    (tmp_path / "map.pfm").write_bytes(content)
    for reader in (read_image, ImageRows):
        with pytest.raises(LightdomeError, match=reason):
            reader(tmp_path / "map.pfm")
