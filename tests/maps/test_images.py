"""Orientation and values in every format, compared with bytes written by hand."""

from __future__ import annotations

from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from image_bytes import IMAGE, exr, hdr, pfm
from lightdome.errors import LightdomeError
from lightdome.maps.images import auto_exposure, read_image, tone_map, write_image


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("little.pfm", pfm(IMAGE)),
        ("big.pfm", pfm(IMAGE, ">")),
        ("map.exr", exr(IMAGE)),
        ("map.hdr", hdr(IMAGE, b"-Y 2 +X 4")),
        ("up.hdr", hdr(IMAGE[::-1], b"+Y 2 +X 4")),
        ("left.hdr", hdr(IMAGE[:, ::-1], b"-Y 2 -X 4")),
        ("turned.hdr", hdr(IMAGE[::-1, ::-1], b"+Y 2 -X 4")),
        ("columns.hdr", hdr(IMAGE.swapaxes(0, 1), b"+X 4 -Y 2")),
    ],
)
def test_row_0_is_the_top_of_every_format(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    np.testing.assert_array_equal(read_image(tmp_path / name), IMAGE)


def test_one_channel_is_read_as_grey(tmp_path: Path) -> None:
    (tmp_path / "grey.pfm").write_bytes(pfm(IMAGE[..., 0]))
    np.testing.assert_array_equal(read_image(tmp_path / "grey.pfm"), np.repeat(IMAGE[..., :1], 3, axis=2))


def test_pfm_is_written_bottom_up(tmp_path: Path) -> None:
    write_image(tmp_path / "a.pfm", IMAGE)
    content = (tmp_path / "a.pfm").read_bytes()
    assert content.startswith(b"PF\n4 2\n-1")
    assert content.endswith(IMAGE[::-1].astype("<f4").tobytes())


def test_ppm_and_png_are_written_top_down(tmp_path: Path) -> None:
    pixels = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    write_image(tmp_path / "a.ppm", pixels)
    assert (tmp_path / "a.ppm").read_bytes() == b"P6\n4 2\n255\n" + pixels.tobytes()
    write_image(tmp_path / "a.png", pixels)
    read = matplotlib.image.imread(tmp_path / "a.png")  # by a library other than the one that wrote it
    np.testing.assert_array_equal(np.rint(read * 255).astype(np.uint8), pixels)


def test_tone_mapping_is_exposure_then_gamma() -> None:
    values = tone_map(np.array([0, 0.125, 0.25, 0.5, 7, np.inf], np.float32), exposure=2, gamma=2)
    np.testing.assert_array_equal(values, [0, 128, 180, 255, 255, 255])


def test_auto_exposure_ignores_the_black_background() -> None:
    image = np.zeros((100, 100, 3), np.float32)
    image[:2, :50] = 4
    assert auto_exposure(image) == 0.25
    assert auto_exposure(image * 0) == 1


@pytest.mark.parametrize("channel", [0, 1, 2])
def test_auto_exposure_makes_the_95th_percentile_of_the_largest_channel_white(channel: int) -> None:
    levels = np.random.default_rng(4).permutation(np.arange(1, 202))  # the 95th percentile of 1 .. 201 is 191
    image = np.zeros((3, 101, 3), np.float32)
    image.reshape(-1, 3)[:201, channel] = levels
    image[..., (channel + 1) % 3] = image[..., channel] / 4
    image[2, 5] = np.inf
    assert 1 / auto_exposure(image) == pytest.approx(191)
    for scale in (1e-3, 1e3):
        assert auto_exposure(image * np.float32(scale)) * scale == pytest.approx(1 / 191)


@pytest.mark.parametrize(
    ("name", "content"), [("a.pfm", pfm(IMAGE)), ("a.exr", exr(IMAGE)), ("a.hdr", hdr(IMAGE, b"-Y 2 +X 4"))]
)
def test_a_truncated_file_is_refused_in_one_line(tmp_path: Path, name: str, content: bytes) -> None:
    path = tmp_path / name
    for length in {0, 1, 11, len(content) // 2, len(content) - 9, len(content) - 1}:
        path.write_bytes(content[:length])
        with pytest.raises(LightdomeError) as error:
            read_image(path)
        assert str(path) in str(error.value)
        assert "\n" not in str(error.value)


def test_a_header_that_lies_about_the_size_costs_no_memory(tmp_path: Path) -> None:
    path = tmp_path / "liar.pfm"
    path.write_bytes(b"PF\n30000 30000\n-1.0\n" + bytes(100))
    with pytest.raises(LightdomeError, match="claims"):
        read_image(path)
    (tmp_path / "liar.hdr").write_bytes(b"#?RADIANCE\n\n-Y 30000 +X 30000\n" + bytes(100))
    with pytest.raises(LightdomeError, match="claims 30000 x 30000 pixels"):
        read_image(tmp_path / "liar.hdr")
    path.write_bytes(b"PF\n2000000000 2000000000\n-1.0\n" + bytes(100))
    with pytest.raises(LightdomeError):
        read_image(path)


@pytest.mark.parametrize("name", ["missing.exr", "folder.exr", "text.exr", "map.jpg"])
def test_what_is_no_map_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "folder.exr").mkdir()
    (tmp_path / "text.exr").write_text("no image at all")
    (tmp_path / "map.jpg").write_bytes(b"\xff\xd8\xff")
    with pytest.raises(LightdomeError, match=name):
        read_image(tmp_path / name)


def test_a_file_that_cannot_be_written_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(LightdomeError, match="nowhere"):
        write_image(tmp_path / "nowhere" / "a.pfm", IMAGE)
    (tmp_path / "taken.png").mkdir()
    with pytest.raises(LightdomeError, match="taken"):
        write_image(tmp_path / "taken.png", IMAGE.astype(np.uint8))
    assert [p.name for p in tmp_path.iterdir()] == ["taken.png"]


def test_a_pfm_larger_than_64_mib_holds_every_row_in_its_place(tmp_path: Path) -> None:
    height, width = 1500, 4000
    values = np.arange(height * width * 3, dtype=np.uint32) * np.uint32(2654435761)  # no two rows are alike
    image = (values >> 9 | 0x3F800000).view(np.float32).reshape(height, width, 3)
    path = tmp_path / "large.pfm"
    write_image(path, image)
    content = path.read_bytes()
    assert len(content) > 64 << 20
    header, values = content[: -image.nbytes], np.frombuffer(content[-image.nbytes :], "<f4")
    assert header.split() == [b"PF", b"4000", b"1500", b"-1.0000"]
    assert np.array_equal(values.reshape(image.shape)[::-1], image)
    assert np.array_equal(read_image(path), image)
    path.unlink()
