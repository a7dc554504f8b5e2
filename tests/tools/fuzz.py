"""Mutated maps and sample files: each must be read, or refused in one line, within bounded time and memory.

    python tests/tools/fuzz.py --count 10000 --seed 1

Valid files of every kind are damaged at random, with and without knowledge of their format. A worker process reads
them, so a file may crash, hang or bloat it without harm. A file that is neither read nor refused is a failure: it is
kept, with the command that repeats it. The same seed makes the same files.
"""

from __future__ import annotations

import argparse
import io
import itertools
import json
import re
import resource
import select
import struct
import subprocess
import sys
import tempfile
import time
import traceback
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from exr_bytes import Part, exr_file, planes
from lightdome.errors import LightdomeError
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.geometry import column_angles, row_angles
from lightdome.maps.images import ImageRows, read_image
from lightdome.progress import Progress
from lightdome.sampling.samples import Samples

SECONDS = 60.0  # allowed per file, including the worker's start, even on a busy machine
MEBIBYTES = 256  # allowed per file; the valid files have a few thousand pixels
ADDRESS_SPACE = 8 << 30  # bytes, so that a bloated worker fails and not the machine
COMPRESSIONS = ("none", "rle", "zip", "zips", "piz", "pxr24", "b44", "b44a", "dwaa", "dwab")
NUMBERS = (0, 1, 2, 7, 127, 128, 255, 256, 4096, 32767, 32768, 65535, 65536, 2**20, 2**24, 2**30)
NUMBERS += (2**31 - 1, 2**31, 2**32 - 1, 2**32, 2**63 - 1, 2**63, 2**64 - 1, 10**30)
EXR_ATTRIBUTES = (b"channels", b"compression", b"dataWindow", b"displayWindow", b"lineOrder", b"tiles", b"type")
EXR_ATTRIBUTES += (b"chunkCount", b"name", b"pixelAspectRatio", b"screenWindowWidth", b"version", b"Orientation")
EXR_ATTRIBUTES += (b"envmap", b"chromaticities")

Mutation = Callable[[np.random.Generator, bytes], bytes]


# The valid files


def corpus() -> dict[str, bytes]:
    """Small valid files by name, of every format, compression and layout that the readers support."""
    rng = np.random.default_rng(0)
    radiance = np.exp(rng.normal(0, 2, (37, 74, 3))).astype(np.float32)
    radiance[5:9] = 0.25  # something to compress
    files = {
        "little.pfm": b"PF\n74 37\n-1.0\n" + radiance[::-1].astype("<f4").tobytes(),
        "big.pfm": b"PF\n74 37\n1.0\n" + radiance[::-1].astype(">f4").tobytes(),
        "grey.pfm": b"Pf\n74 37\n-1.0\n" + radiance[::-1, :, 0].astype("<f4").tobytes(),
        "flat.hdr": b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=1\n\n-Y 37 +X 74\n"
        + rng.integers(3, 256, (37, 74, 4), np.uint8).tobytes(),
        "turned.hdr": b"#?RGBE\nFORMAT=32-bit_rle_rgbe\n\n+X 74 -Y 37\n"
        + rng.integers(3, 256, (37, 74, 4), np.uint8).tobytes(),
        "factors.hdr": b"#?AUTOPANO\nEXPOSURE = 2\nEXPOSURE=1e-1\nCOLORCORR=1 2 3\n\n-X 74 -Y 37\n"
        + rng.integers(3, 256, (37, 74, 4), np.uint8).tobytes(),
        "old_runs.hdr": b"#?RADIANCE\n\n-Y 300 +X 300\n" + bytes([9, 8, 7, 128, 1, 1, 1, 43, 1, 1, 1, 1]) * 300,
        "four.pfm": b"PF4 # RGBA\r\n37 37\n-2e0\n" + radiance[::-1].astype("<f4").tobytes()[: 37 * 37 * 16],
        "samples.npz": npz(arrays()),
        "packed.npz": npz(arrays(), zipfile.ZIP_DEFLATED),
    }
    with tempfile.TemporaryDirectory() as folder:
        files["rle.hdr"] = _written(Path(folder) / "rle.hdr", radiance)
        for compression in COMPRESSIONS:
            for kind, tile in itertools.product((oiio.HALF, oiio.FLOAT), (0, 32)):
                name = f"{compression}_{kind}_{'tiles' if tile else 'lines'}.exr".lower().replace("basetype.", "")
                files[name] = _written(Path(folder) / name, radiance, compression, kind, tile)
        for channels in (1, 2, 4, 7):
            more = np.concatenate([radiance] * 3, axis=2)[..., :channels]
            files[f"{channels}_channels.exr"] = _written(Path(folder) / f"{channels}.exr", more)
        files |= by_hand(radiance)
        files["parts.exr"] = _two_parts(Path(folder) / "parts.exr", radiance)
        files["deep.exr"] = _deep(Path(folder) / "deep.exr")
    return files


def by_hand(radiance: np.ndarray) -> dict[str, bytes]:
    """EXR files that OpenImageIO cannot write: integers, luminance and chroma, deep parts next to flat ones."""
    grey = radiance[..., 0]
    layers = {f"{layer}.{name}": plane for layer in ("depth", "rgba") for name, plane in planes(radiance).items()}
    primaries = {"chromaticities": ("chromaticities", struct.pack("<8f", 0.7, 0.3, 0.2, 0.7, 0.1, 0.1, 0.3, 0.3))}
    return {
        "whole.exr": exr_file(Part({**planes(radiance), "G": np.minimum(grey, 1e6).astype(np.uint32)})),
        "chroma.exr": exr_file(Part({"Y": grey, "RY": grey * 0, "BY": grey * 0 - 1}, attributes=primaries)),
        "layers.exr": exr_file(Part(layers, attributes={"envmap": ("envmap", b"\0")})),
        "deep_and_flat.exr": exr_file(Part({"Z": grey}, "far", deep=True), Part(planes(radiance), "near")),
    }


def image_spec(pixels: np.ndarray, compression: str = "zip", kind: object = oiio.HALF, tile: int = 0) -> oiio.ImageSpec:
    height, width, channels = pixels.shape
    spec = oiio.ImageSpec(width, height, channels, kind)
    spec.attribute("compression", compression)
    if channels == 2:
        spec.channelnames = ("Y", "A")
    if tile:
        spec.tile_width = spec.tile_height = tile
    return spec


def _written(
    path: Path, pixels: np.ndarray, compression: str = "zip", kind: object = oiio.HALF, tile: int = 0
) -> bytes:
    file = oiio.ImageOutput.create(str(path))
    done = file.open(str(path), image_spec(pixels, compression, kind, tile)) and file.write_image(pixels)
    file.close()
    assert done, file.geterror()
    return path.read_bytes()


def _two_parts(path: Path, pixels: np.ndarray) -> bytes:
    specs = (image_spec(pixels), image_spec(pixels, "piz", oiio.FLOAT))
    for name, spec in zip(("beauty", "right"), specs, strict=True):
        spec.attribute("oiio:subimagename", name)
    file = oiio.ImageOutput.create(str(path))
    done = file.open(str(path), specs) and file.write_image(pixels)
    done = done and file.open(str(path), specs[1], "AppendSubimage") and file.write_image(pixels)
    file.close()
    assert done, file.geterror()
    return path.read_bytes()


def _deep(path: Path) -> bytes:
    spec = oiio.ImageSpec(8, 4, 4, oiio.FLOAT)
    spec.deep = True
    spec.channelnames = ("R", "G", "B", "Z")
    deep = oiio.DeepData()
    deep.init(spec)
    for pixel in range(32):
        deep.set_samples(pixel, pixel % 3)
    file = oiio.ImageOutput.create(str(path))
    done = file.open(str(path), spec) and file.write_deep_image(deep)
    file.close()
    assert done, file.geterror()
    return path.read_bytes()


def arrays(count: int = 50) -> dict[str, np.ndarray]:
    """The arrays of a valid sample file."""
    rng = np.random.default_rng(0)
    height, width = 21, 43
    x, y = rng.integers(width, size=count), rng.integers(height, size=count)
    theta, phi = row_angles(height)[y], column_angles(width)[x]
    direction = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)], axis=1)
    return {
        "direction": direction.astype(np.float32),
        "radiance": rng.random((count, 3), np.float32),
        "probability": rng.random(count, np.float32) * 0.99 + np.float32(0.001),
        "pixel": np.stack([x, y], axis=1).astype(np.int32),
        "map_shape": np.array([height, width], np.int32),
        "sequence": np.array("independent"),
        "seed": np.array(2**63, np.uint64),
        "version": np.array("0.1.0"),
    }


def npz(members: dict[str, np.ndarray | bytes], compression: int = zipfile.ZIP_STORED) -> bytes:
    """An ``.npz`` of arrays, or of bytes in place of an array."""
    result = io.BytesIO()
    with zipfile.ZipFile(result, "w", compression) as archive:
        for name, member in members.items():
            archive.writestr(f"{name}.npy", member if isinstance(member, bytes) else npy(member))
    return result.getvalue()


def npy(array: np.ndarray) -> bytes:
    """An ``.npy``, with a pickle in it if the array holds objects."""
    result = io.BytesIO()
    np.lib.format.write_array(result, array, allow_pickle=True)
    return result.getvalue()


# How they are damaged


def flip_bits(rng: np.random.Generator, content: bytes) -> bytes:
    """Flip a few bits, mostly near the beginning, where the header is."""
    broken = bytearray(content)
    for _ in range(rng.integers(1, 6)):
        broken[_place(rng, content)] ^= 1 << int(rng.integers(8))
    return bytes(broken)


def overwrite(rng: np.random.Generator, content: bytes) -> bytes:
    """At a random place, write an integer of 1, 2, 4 or 8 bytes that readers often get wrong."""
    size = int(rng.choice([1, 2, 4, 8]))
    at = _place(rng, content)
    value = int(rng.choice(len(NUMBERS)))
    return content[:at] + (NUMBERS[value] % 256**size).to_bytes(size, "little") + content[at + size :]


def truncate(rng: np.random.Generator, content: bytes) -> bytes:
    """Keep only the first part."""
    return content[: _place(rng, content)]


def insert(rng: np.random.Generator, content: bytes) -> bytes:
    """Insert random bytes, or a copy of a part of the file, in the middle."""
    at, start = _place(rng, content), _place(rng, content)
    more = rng.bytes(int(rng.integers(1, 64))) if rng.random() < 0.5 else content[start : start + 200]
    return content[:at] + more + content[at:]


def delete(rng: np.random.Generator, content: bytes) -> bytes:
    """Leave out a part."""
    at = _place(rng, content)
    return content[:at] + content[at + int(rng.integers(1, 200)) :]


def fill(rng: np.random.Generator, content: bytes) -> bytes:
    """Fill a part with a single byte value."""
    at, size = _place(rng, content), int(rng.integers(1, 400))
    return content[:at] + bytes([int(rng.choice([0, 1, 127, 128, 255]))]) * size + content[at + size :]


def lie_in_text(rng: np.random.Generator, content: bytes) -> bytes:
    """Replace a number in a text header by another number, or by none."""
    found = list(re.finditer(rb"-?\d+(\.\d+)?", content[:200]))
    lies = [str(n).encode() for n in NUMBERS] + [b"-1", b"-74", b"", b"nan", b"inf", b"1e99", b"0x10", b"9" * 5000]
    if not found:
        return flip_bits(rng, content)
    match = found[int(rng.integers(len(found)))]
    return content[: match.start()] + lies[int(rng.integers(len(lies)))] + content[match.end() :]


def lie_in_attribute(rng: np.random.Generator, content: bytes) -> bytes:
    """Change the value or the size of an attribute in an EXR header."""
    found = list(re.finditer(b"|".join(re.escape(name) + rb"\0\w+\0" for name in EXR_ATTRIBUTES), content[:4000]))
    if not found:
        return flip_bits(rng, content)
    match = found[int(rng.integers(len(found)))]
    size = int.from_bytes(content[match.end() : match.end() + 4], "little", signed=True)
    at = match.end() + 4 * int(rng.integers(1 + max(1, size // 4)))
    value = int(rng.choice([*NUMBERS[:20], 2**32 - 74, 2**32 - 1000, 73, 74, 36, 37]))
    return content[:at] + struct.pack("<I", value % 2**32) + content[at + 4 :]


def lie_in_arrays(rng: np.random.Generator, _: bytes) -> bytes:
    """Samples in a valid ``.npz`` of any compression, with arrays that are wrong in one or two ways."""
    members: dict[str, np.ndarray | bytes] = dict(arrays())
    for _ in range(rng.integers(1, 3)):
        name = str(rng.choice(list(members)))
        array = members[name]
        if isinstance(array, bytes) or array.size == 0:
            continue
        mutation = ARRAY_MUTATIONS[int(rng.integers(len(ARRAY_MUTATIONS)))]
        with np.errstate(all="ignore"):
            members[name] = mutation(rng, array)
    if rng.random() < 0.05:
        del members[str(rng.choice(list(members)))]
    kinds = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA)
    content = npz(members, int(rng.choice(kinds)))
    return content if rng.random() < 0.7 else flip_bits(rng, content)


def other_type(rng: np.random.Generator, array: np.ndarray) -> np.ndarray:
    types = ("?", "i1", "u1", ">i4", "i8", "u8", "f2", ">f4", "f8", "g", "c16", "S7", "U7", "U300", "O", "M8[s]", "V8")
    try:
        return array.astype(str(rng.choice(types)))
    except (ValueError, TypeError, OverflowError):
        return array.astype(object)


def _other_shape(rng: np.random.Generator, array: np.ndarray) -> np.ndarray:
    flat = array.ravel()
    shapes = ((-1,), (-1, 1), (1, -1), (1, 1, -1), (0, 3), (0,), ())
    shape = shapes[int(rng.integers(len(shapes)))]
    return flat[:1].reshape(()) if shape == () else flat[:0].reshape(shape) if 0 in shape else flat.reshape(shape)


def _other_value(rng: np.random.Generator, array: np.ndarray) -> np.ndarray:
    result = array.copy()
    if array.dtype.kind == "U":
        words = ("", "\n", "\x1b[2J", "\0", "\ud800", "sobol", "x" * 200, "…")
        return np.array(words[int(rng.integers(len(words)))])
    values = (0, -1, 1, 1e-45, 1e-38, 3e38, -0.0, np.nan, np.inf, -np.inf, 2**31 - 1, -(2**31), 2**20)
    value = values[int(rng.integers(len(values)))]
    result.reshape(-1)[int(rng.integers(result.size))] = np.asarray(value).astype(result.dtype)
    return result


def _wrong_code_point(rng: np.random.Generator, array: np.ndarray) -> np.ndarray | bytes:
    if array.dtype.kind != "U":
        return npy(array)
    return npy(array).replace(b"\0\0\0", rng.bytes(3), 3)


def _other_header(rng: np.random.Generator, array: np.ndarray) -> bytes:
    lies = [
        b"(-1,)",
        b"(2000000000, 3)",
        b"(134217728, 3)",
        b"(1073741824,)",
        b"(((((",
        b"'''",
        b"(3L,)",
        b"()",
        b"(0, 3)",
    ]
    lies += [b"(" * 3000, b"(1 << 99,)", b"{}", b"\n  (2, 3)\n 4", b"True", b"(True, True)", b"(%d,)" % 10**30]
    lie = lies[int(rng.integers(len(lies)))]
    content = npy(array)
    end = content.index(b"\n")
    if rng.random() < 0.3:
        return flip_bits(rng, content[: end + 1]) + content[end + 1 :]
    header = re.sub(rb"\([\d, ]*\)", lambda _: lie, content[10:end])
    return content[:8] + struct.pack("<H", len(header) + 1) + header + b"\n" + content[end + 1 :]


def bomb(rng: np.random.Generator, array: np.ndarray) -> bytes:
    """A million samples of zero, or fewer of large types, which deflate to a few kilobytes."""
    size = max(1, int(np.prod(array.shape[1:])) * array.dtype.itemsize)
    shape = (min(2**20, 2**25 // size), *array.shape[1:])
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": array.dtype.str, "fortran_order": False, "shape": shape})
    return header.getvalue() + bytes(int(np.prod(shape)) * array.dtype.itemsize)


ARRAY_MUTATIONS = (other_type, _other_shape, _other_value, _wrong_code_point, _other_header, bomb)
MUTATIONS: tuple[Mutation, ...] = (flip_bits, overwrite, truncate, insert, delete, fill)
FORMAT_MUTATIONS: dict[str, Mutation] = {
    ".pfm": lie_in_text,
    ".hdr": lie_in_text,
    ".exr": lie_in_attribute,
    ".npz": lie_in_arrays,
}


def _place(rng: np.random.Generator, content: bytes) -> int:
    end = len(content) if rng.random() < 0.5 else min(600, len(content))
    return int(rng.integers(max(1, end)))


def mutant(files: dict[str, bytes], seed: int, index: int) -> tuple[str, bytes]:
    """The suffix and content of file ``index`` for ``seed``."""
    rng = np.random.default_rng([seed, index])
    # Every format gets its share, however many valid files it has.
    suffix = str(rng.choice([".pfm", ".hdr", ".exr", ".exr", ".npz"]))
    names = [name for name in files if name.endswith(suffix)]
    content = files[str(rng.choice(names))]
    for _ in range(1 + (rng.random() < 0.3)):
        if not content:
            break
        special = rng.random() < 0.5
        mutation = FORMAT_MUTATIONS[suffix] if special else MUTATIONS[int(rng.integers(len(MUTATIONS)))]
        content = mutation(rng, content)
    return suffix, content


# Reading them


def read(path: Path) -> str:
    """Read a file and use its content; returns ``read``, or how it was refused. Anything else is raised."""
    try:
        if path.suffix == ".npz":
            samples = Samples.load(path)
            assert samples.direction.shape == samples.radiance.shape == samples.flux.shape == (len(samples), 3)
            assert samples.probability.dtype == samples.direction.dtype == samples.radiance.dtype == np.float32
            assert samples.pixel.dtype == np.int32
            assert np.isfinite(samples.flux).all()
            assert (np.abs(np.linalg.norm(samples.direction.astype(float), axis=1) - 1) < 1e-4).all()
        else:
            radiance = EnvironmentMap(_read_both_ways(path), sanitize=True).radiance
            assert radiance.ndim == 3
            assert radiance.shape[2] == 3
            assert radiance.dtype == np.float32
            assert np.isfinite(radiance).all()
            assert (radiance >= 0).all()
    except LightdomeError as error:
        message = str(error)
        assert len(message.splitlines()) == 1, message
        assert message.isprintable(), message
        assert len(message) < 500, message
        return f"refused: {message}"
    return "read"


def _read_both_ways(path: Path) -> np.ndarray:
    """Read an image as a whole and by rows; both must give the same pixels, or both must refuse it."""
    try:
        rows = ImageRows(path, batch=10)
        by_rows = np.empty((rows.height, rows.width, 3), np.float32)
        for batch, pixels in rows.read(np.arange(rows.height)):
            by_rows[batch] = pixels
    except LightdomeError:
        by_rows = None
    try:
        image = read_image(path)
    except LightdomeError:
        assert by_rows is None, "refused as a whole, but read by rows"
        raise
    assert by_rows is not None, "read as a whole, but refused by rows"
    np.testing.assert_array_equal(by_rows, image)
    return image


def work() -> None:
    """Read the files named on standard input; print a line per file: seconds, mebibytes, and the verdict."""
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE, ADDRESS_SPACE))
    for line in sys.stdin:
        before = _peak_of_memory()
        start = time.perf_counter()
        try:
            verdict = read(Path(line.rstrip("\n")))
        except BaseException:
            verdict = f"failed: {traceback.format_exc()}"
        print(json.dumps([time.perf_counter() - start, _peak_of_memory() - before, verdict]), flush=True)


def _peak_of_memory() -> float:
    """This process's peak memory in mebibytes since the last call, as Linux counts it; 0 on other systems."""
    try:
        status = Path("/proc/self/status").read_text()
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return 0.0
    return int(status.partition("VmHWM:")[2].split()[0]) / 1024


@dataclass
class Worker:
    """A process that reads files, in a folder that must hold nothing else."""

    process: subprocess.Popen[str]
    errors: Path

    def read(self, path: Path, seconds: float = SECONDS) -> str:
        """The verdict on one file within ``seconds``: ``read``, ``refused: ...`` or ``failed: ...``."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        print(path, file=self.process.stdin, flush=True)
        if not select.select([self.process.stdout], [], [], seconds)[0]:
            self.process.kill()
            self.process.wait()
            return f"failed: did not finish within {seconds:g} s"
        answer = self.process.stdout.readline()
        if not answer:
            return f"failed: ended with status {self.process.wait()}"
        took, mebibytes, verdict = json.loads(answer)
        if self.errors.stat().st_size:
            said = self.errors.read_text(errors="replace")
            self.errors.write_text("")
            return f"failed: printed {said[:300]!r}, then {verdict}"
        if mebibytes > MEBIBYTES:
            return f"failed: took {mebibytes:.0f} MiB and {took:.1f} s, then {verdict}"
        return str(verdict)


@contextmanager
def worker(folder: Path) -> Iterator[Worker]:
    """A worker with ``folder`` as its current and its temporary folder."""
    with tempfile.NamedTemporaryFile("a+") as errors:
        process = subprocess.Popen(
            # Warnings count as errors, since a user would see them as extra lines.
            [sys.executable, "-W", "error", str(Path(__file__).resolve()), "--work"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
            cwd=folder,
            env={"TMPDIR": str(folder)},
        )
        try:
            yield Worker(process, Path(errors.name))
        finally:
            process.kill()
            process.communicate()


def fuzz(
    count: int, seed: int, keep: Path, first: int = 0, read: Callable[[Worker, Path], str] = Worker.read
) -> tuple[Counter[str], list[str]]:
    """``read`` ``count`` mutants of ``seed``; returns how many were read or refused by suffix, and the failures.

    Files that failed are kept in ``keep``, which is created when the first one fails.
    """
    files = corpus()
    counts: Counter[str] = Counter()
    failures: list[str] = []
    with tempfile.TemporaryDirectory() as folder, Progress("fuzzing") as progress:
        index = first
        while index < first + count:
            with worker(Path(folder)) as reader:
                while index < first + count and reader.process.poll() is None:
                    suffix, content = mutant(files, seed, index)
                    path = Path(folder) / f"{seed}_{index}{suffix}"
                    path.write_bytes(content)
                    verdict = read(reader, path)
                    left = {p.name for p in Path(folder).iterdir()} - {path.name}
                    if left:
                        verdict = f"failed: left {sorted(left)} on disk, then {verdict}"
                    if verdict.startswith("failed"):
                        keep.mkdir(parents=True, exist_ok=True)
                        (keep / path.name).write_bytes(content)
                        failures.append(f"{keep / path.name}: {verdict}")
                    counts[f"{suffix} {verdict.partition(':')[0]}"] += 1
                    path.unlink()
                    index += 1
                    progress.update((index - first) / count)
    return counts, failures


def main() -> None:
    """Fuzz, and exit with 1 if a file was neither read nor refused."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=10000, metavar="N", help="files to read (default: 10000)")
    parser.add_argument("--seed", type=int, default=0, help="another seed makes other files (default: 0)")
    parser.add_argument("--first", type=int, default=0, metavar="I", help="index of the first file (default: 0)")
    parser.add_argument("--keep", type=Path, default=Path("out/fuzz"), metavar="DIR", help="where failures are kept")
    parser.add_argument("--work", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.work:
        work()
        return
    start = time.monotonic()
    counts, failures = fuzz(args.count, args.seed, args.keep, args.first)
    for failure in failures:
        print(failure)
    for verdict, number in sorted(counts.items()):
        print(f"{verdict:<14}{number:>7}")
    print(f"seed {args.seed}, {args.count} files in {time.monotonic() - start:.0f} s, {len(failures)} failures")
    sys.exit(bool(failures))


if __name__ == "__main__":
    main()
