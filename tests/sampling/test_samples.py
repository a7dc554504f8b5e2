"""The .npz interface: saved samples load, and nothing else does."""

from __future__ import annotations

import io
import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lightdome import __version__
from lightdome.errors import LightdomeError
from lightdome.maps.envmap import EnvironmentMap
from lightdome.opencl.device import Device
from lightdome.sampling.distribution import build_distribution
from lightdome.sampling.samples import Samples


@pytest.fixture(scope="module")
def samples(device: Device, stiff: EnvironmentMap) -> Samples:
    return build_distribution(device, stiff).sample(50, seed=2**63)


@pytest.fixture
def saved(samples: Samples, tmp_path: Path) -> Path:
    samples.save(tmp_path / "samples.npz")
    return tmp_path / "samples.npz"


def test_saved_samples_load_unchanged(samples: Samples, saved: Path) -> None:
    loaded = Samples.load(saved)
    for name in ("direction", "radiance", "probability", "pixel"):
        array = getattr(loaded, name)
        np.testing.assert_array_equal(array, getattr(samples, name))
        assert array.dtype == getattr(samples, name).dtype
    assert (loaded.map_shape, loaded.sequence, loaded.seed) == ((21, 43), "independent", 2**63)
    assert loaded.version == __version__
    assert [p.name for p in saved.parent.iterdir()] == ["samples.npz"]


def test_the_file_is_what_the_interface_says(saved: Path) -> None:
    with np.load(saved, allow_pickle=False) as file:
        shapes = {name: (file[name].dtype.str, file[name].shape) for name in file.files}
    assert shapes["direction"] == ("<f4", (50, 3))
    assert shapes["radiance"] == ("<f4", (50, 3))
    assert shapes["probability"] == ("<f4", (50,))
    assert shapes["pixel"] == ("<i4", (50, 2))
    assert shapes["map_shape"][1] == (2,)


def test_damaged_bytes_are_refused_unless_the_arrays_are_whole(samples: Samples, saved: Path) -> None:
    content = saved.read_bytes()
    rng = np.random.default_rng(0)
    refused: list[str] = []
    for trial in range(300):
        broken = bytearray(content)
        if trial % 3 == 0:
            broken = broken[: rng.integers(len(broken))]
        else:
            for _ in range(rng.integers(1, 4)):
                broken[rng.integers(len(broken))] ^= 1 << rng.integers(8)
        saved.write_bytes(broken)
        try:
            loaded = Samples.load(saved)
        except LightdomeError as error:
            refused.append(str(error))
        else:  # an unused byte, such as a date's
            assert len(broken) == len(content)
            for name, value in vars(samples).items():
                np.testing.assert_array_equal(getattr(loaded, name), value)
    assert len(refused) > 200
    for message in refused:
        assert str(saved) in message
        assert "\n" not in message


def rewrite(path: Path, **changes: Any) -> None:
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    arrays.update(changes)
    np.savez(path, **{name: array for name, array in arrays.items() if array is not None})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"pixel": None}, "no array 'pixel'"),
        ({"direction": np.zeros((49, 3), np.float32)}, "same length"),
        ({"direction": np.zeros((50, 4), np.float32)}, "shape"),
        ({"direction": np.zeros((50, 3), np.float32)}, "not that of its pixel"),
        ({"radiance": np.zeros((50, 3), np.int32)}, "wrong type"),
        ({"probability": np.zeros(50, np.float32)}, "probability"),
        ({"pixel": np.full((50, 2), 43, np.int32)}, "outside the map"),
        ({"pixel": np.full((50, 2), -1, np.int32)}, "outside the map"),
        ({"map_shape": np.array([0, 0])}, "map_shape must be"),
        ({"map_shape": np.array([2**40, 2**40])}, "map_shape must be"),
        ({"map_shape": np.ones(10**6, np.int8)}, "wrong type or shape"),  # not checked one by one
        ({"map_shape": np.array([21, 44])}, "not that of its pixel"),
        ({"sequence": np.array(3)}, "wrong type"),
    ],
)
def test_arrays_that_contradict_each_other_are_refused(saved: Path, changes: dict[str, Any], message: str) -> None:
    rewrite(saved, **changes)
    with pytest.raises(LightdomeError, match=message):
        Samples.load(saved)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -1.0])
@pytest.mark.parametrize("at", [0, 49])
@pytest.mark.parametrize("name", ["direction", "radiance", "probability"])
def test_a_single_impossible_value_is_refused(samples: Samples, saved: Path, name: str, at: int, value: float) -> None:
    if name == "direction" and value == -1:
        value = -1.5
    for channel in range(3 if name != "probability" else 1):
        array = getattr(samples, name).astype(np.float64)
        array.reshape(50, -1)[at, channel] = value
        for stored in (array, array.astype(np.float32)):
            rewrite(saved, **{name: stored})
            with pytest.raises(LightdomeError, match=rf"{name} is n.*\(sample {at}\)"):
                Samples.load(saved)
        with pytest.raises(LightdomeError, match=name):
            Samples(**{**vars(samples), name: array})


def test_no_samples_at_all_are_refused(saved: Path) -> None:
    rewrite(
        saved,
        direction=np.zeros((0, 3), np.float32),
        radiance=np.zeros((0, 3), np.float32),
        probability=np.zeros(0, np.float32),
        pixel=np.zeros((0, 2), np.int32),
    )
    with pytest.raises(LightdomeError, match="one or more"):
        Samples.load(saved)


class Bomb:
    def __reduce__(self) -> tuple[Any, ...]:
        return (pytest.fail, ("a pickle was read",))


def test_a_pickle_is_never_read(saved: Path) -> None:
    rewrite(saved, direction=np.array([Bomb()] * 150, dtype=object).reshape(50, 3))
    with pytest.raises(LightdomeError, match="wrong type"):
        Samples.load(saved)
    saved.write_bytes(pickle.dumps(Bomb()))
    with pytest.raises(LightdomeError, match=r"no \.npz file"):
        Samples.load(saved)


def test_a_header_that_lies_about_the_size_costs_no_memory(saved: Path) -> None:
    array = io.BytesIO()
    np.lib.format.write_array_header_1_0(array, {"descr": "<f4", "fortran_order": False, "shape": (2**26, 3)})
    with zipfile.ZipFile(saved, "w") as archive:
        archive.writestr("direction.npy", array.getvalue())
    with pytest.raises(LightdomeError, match="not as long as it says"):
        Samples.load(saved)


@pytest.mark.parametrize("name", ["missing.npz", "folder.npz", "text.npz", "empty.npz", "single.npz"])
def test_files_other_than_samples_are_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "folder.npz").mkdir()
    (tmp_path / "text.npz").write_text("no samples")
    (tmp_path / "empty.npz").touch()
    np.save(tmp_path / "single.npy", np.zeros(3))
    (tmp_path / "single.npy").rename(tmp_path / "single.npz")
    with pytest.raises(LightdomeError, match=name):
        Samples.load(tmp_path / name)


@pytest.mark.parametrize(("axis", "value"), [(0, 43), (1, 21), (0, -1), (1, -1)])
def test_a_pixel_just_beyond_an_edge_of_the_map_is_refused_and_named(
    samples: Samples, saved: Path, axis: int, value: int
) -> None:
    pixel = samples.pixel.copy()
    pixel[7, axis] = value
    rewrite(saved, pixel=pixel)
    with pytest.raises(LightdomeError, match=r"outside the map \(sample 7\)"):
        Samples.load(saved)
