"""Computes the row of one map: what it contains and, if asked for, lights, harmonics, their errors and pictures."""

from __future__ import annotations

import hashlib
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__, checks
from ..cache import key_of
from ..errors import LightdomeError
from ..evaluation.metrics import relative_rmse
from ..float_range import LARGEST_HALF
from ..lighting.exact import exact
from ..lighting.harmonics import project, shade_harmonics
from ..lighting.light_files import write_lights
from ..lighting.lights import Lights
from ..lighting.median_cut import median_cut
from ..lighting.shade import shade
from ..maps.analysis import Analysis, analyse, analyse_resampled
from ..maps.conversion import convert
from ..maps.envmap import EnvironmentMap, Inspection, read_projected
from ..maps.geometry import solid_angles
from ..maps.images import ImageRows, auto_exposure, tone_map
from ..maps.pictures import Picture
from ..names import LIGHT_FORMATS
from ..opencl.device import Device
from ..sampling.distribution import build_distribution
from .columns import harmonic_names, of_analysis

SPHERE = 127  # side of the sphere's image on which errors are measured, in pixels
THUMBNAIL = 256  # width in pixels
BYTES_PER_PIXEL = 64  # memory for a map being computed, with its tables, and for the next, being read
BLOCK = 1 << 20


@dataclass(frozen=True)
class Options:
    """What is computed. A row is computed again if these options, the map or the version change.

    - ``lights``: number of lights, 0 for none; ``harmonics``: their order, None for none
    - ``samples``: number of samples in a file per map, 0 for no file
    - ``light_format``: format of a file of lights per map, None for no file; ``thumbnails``: whether to make pictures
    - ``device``: as :func:`lightdome.open_device` takes it
    - ``memory``: bytes for the maps in a worker, and of a file from a URL; larger maps are read in bands
    """

    lights: int = 16
    harmonics: int | None = 2
    samples: int = 0
    light_format: str | None = None
    thumbnails: bool = False
    device: str | None = None
    memory: int = 3_300_000_000

    @property
    def key(self) -> str:
        """A string that differs if the options or the version differ."""
        return key_of(__version__, repr(sorted(asdict(self).items())))

    @property
    def stages(self) -> list[str]:
        """The timed stages, in order."""
        wanted = {"hash": True, "read": True, "info": True, "exact": self.needs_sphere, "lights": self.lights}
        wanted |= {"harmonics": self.harmonics is not None, "samples": self.samples, "thumbnails": self.thumbnails}
        return [name for name, is_wanted in wanted.items() if is_wanted]

    @property
    def needs_sphere(self) -> bool:
        """Whether the exact image is needed, as a picture or to measure errors."""
        return self.lights > 0 or self.harmonics is not None or self.thumbnails

    @property
    def files(self) -> list[str]:
        """The kinds of file written for each map."""
        wanted = {"lights": self.light_format, "samples": self.samples, "thumbnail": self.thumbnails}
        wanted["sphere"] = self.thumbnails
        return [name for name, is_wanted in wanted.items() if is_wanted]


@dataclass
class Row:
    """Values by column name, and contents of files by their paths in the catalog's folder.

    ``version`` is what a server says about the version of a file; None for a local file.
    """

    values: dict[str, Any]
    files: dict[str, bytes] = field(default_factory=dict)
    version: str | None = None

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        begin = time.perf_counter()
        yield
        self.values[f"seconds_{stage}"] = time.perf_counter() - begin


def digest(path: Path) -> tuple[str, int]:
    """SHA-256 and size in bytes of a file. Raises :class:`LightdomeError` if it cannot be read."""
    found, size = hashlib.sha256(), 0
    try:
        with path.open("rb") as file:
            while block := file.read(BLOCK):
                found.update(block)
                size += len(block)
    except OSError as error:
        raise LightdomeError(f"cannot read {path}: {error.strerror}") from error
    return found.hexdigest(), size


class HeldRows(ImageRows):
    """All rows of a file, read once into ``radiance`` (H, W, 3). :meth:`read` yields them as if from the file."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.radiance = np.empty((self.height, self.width, 3), np.float32)
        self._held = []
        for rows, pixels in super().read(np.arange(self.height)):
            part = self.radiance[rows[0] : rows[-1] + 1]
            part[...] = pixels
            self._held.append((rows, part))

    def read(self, rows: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        return iter(self._held)


@dataclass(frozen=True)
class ReadMap:
    """A map that has been read, for :func:`fill`.

    A latitude-longitude map has ``rows``, in memory or, if ``step`` is above 1, still in the file; its ``envmap`` is
    None until :func:`fill` makes it, averaged over squares of ``step`` pixels. A map in another projection has
    ``resampled``, its analysis, and ``envmap``, the converted map.
    """

    rows: ImageRows | None
    step: int
    resampled: Analysis | None
    envmap: EnvironmentMap | None

    @property
    def latlong(self) -> ImageRows:
        """The rows of a latitude-longitude map."""
        assert self.rows is not None
        return self.rows


def read(path: Path, memory: int) -> ReadMap:
    """Read a map in any projection. One that does not fit into ``memory`` bytes is left to be read in bands."""
    image = ImageRows(path)
    step = _step(image, memory)
    if image.is_cube or image.width != 2 * image.height:
        if step > 1:
            raise LightdomeError(
                f"a map of {image.width} x {image.height} pixels needs more memory than a worker has, and only"
                " latitude-longitude maps of 2:1 can be read in bands; raise --limit-memory"
            )
        found = read_projected(path, sanitize="clamp")
        if found.projection != "latlong":
            envmap = EnvironmentMap(convert(found.radiance, found.projection))
            return ReadMap(None, 1, analyse_resampled(found, envmap), envmap)
    return ReadMap(image if step > 1 else HeldRows(path), step, None, None)


def _step(image: ImageRows, memory: int) -> int:
    """The side, in pixels, of the squares to average so that the map fits into memory; 1 if it fits as it is."""
    step = 1
    while BYTES_PER_PIXEL * image.height * image.width > memory * step**2:
        step += 1
        while image.height % step or image.width % step:
            step += 1
            if step > image.height:
                raise LightdomeError(f"{image.width} x {image.height} pixels do not fit into a worker's memory")
    return step


def fill(row: Row, of: ReadMap, device: Device, options: Options, name: str) -> None:
    """Fill ``row`` with what ``options`` ask for; the map's files are named after ``name``."""
    with row.timed("info"):
        analysis = of.resampled or analyse(of.latlong)
        envmap = of.envmap or _mended(of)
        if of.step > 1:
            note = (
                f"note: lights, harmonics and pictures come from the map averaged to {envmap.width} x {envmap.height}"
            )
            analysis = replace(analysis, notes=(*analysis.notes, note))
        row.values.update(of_analysis(analysis))
    is_lit = envmap.peak > 0
    sphere = None
    distribution = build_distribution(device, envmap)
    if options.needs_sphere:
        with row.timed("exact"):
            sphere = exact(device, distribution.map, SPHERE)
    if options.lights and is_lit:
        with row.timed("lights"):
            lights = median_cut(distribution, options.lights)
            row.values["lights"] = _rows_of(lights)
            row.values["lights_relative_rmse"] = _rmse(shade(device, lights, resolution=SPHERE), sphere)
            if options.light_format:
                suffix = LIGHT_FORMATS[options.light_format]
                _keep(row, "lights", f"lights/{name}{suffix}", lambda path: write_lights(path, lights))
    if options.harmonics is not None:
        with row.timed("harmonics"):
            harmonics = project(device, distribution.map, options.harmonics)
            flat = harmonics.coefficients.ravel().tolist()
            row.values.update(zip(harmonic_names(options.harmonics), flat, strict=True))
            if is_lit:
                row.values["harmonics_relative_rmse"] = _rmse(shade_harmonics(device, harmonics, SPHERE), sphere)
    if options.samples and is_lit:
        with row.timed("samples"):
            samples = distribution.sample(options.samples, sequence="sobol")
            _keep(row, "samples", f"samples/{name}.npz", samples.save)
    if options.thumbnails and sphere is not None:
        with row.timed("thumbnails"):
            step = -(-envmap.width // THUMBNAIL)
            small = averaged([(np.arange(envmap.height), envmap.radiance)], envmap.height, envmap.width, step)
            for kind, image in ("thumbnail", small), ("sphere", sphere):
                picture = Picture(tone_map(image, auto_exposure(image)))
                row.values[f"{kind}_file"] = path = f"thumbnails/{name}_{kind}.png"
                row.files[path] = picture._repr_png_()


def averaged(batches: Iterable[tuple[np.ndarray, np.ndarray]], height: int, width: int, step: int) -> np.ndarray:
    """Means over squares of ``step`` pixels, by solid angle to keep the flux, from batches of rows: float32."""
    shape = -(-height // step), -(-width // step), 3
    total, area = np.zeros(shape), np.zeros(shape[0])
    weight = solid_angles(height, width)
    starts = np.arange(0, width, step)
    for rows, pixels in batches:
        of_rows = np.add.reduceat(pixels, starts, axis=1, dtype=np.float64) * weight[rows, None, None]
        np.add.at(total, rows // step, of_rows)
        area += np.bincount(rows // step, weight[rows], shape[0])
    across = np.diff(np.append(starts, width))
    return (total / (area[:, None] * across)[..., None]).astype(np.float32)


def _mended(of: ReadMap) -> EnvironmentMap:
    """The map with bad values replaced as :func:`analyse` replaces them."""
    rows = of.latlong
    inspection = Inspection("clamp" if rows.largest == LARGEST_HALF else "black", LARGEST_HALF)
    if isinstance(rows, HeldRows):
        radiance = inspection.mended(rows.radiance)
    else:
        batches = rows.read(np.arange(rows.height))
        mended = ((numbers, inspection.mended(pixels, int(numbers[0]))) for numbers, pixels in batches)
        radiance = averaged(mended, rows.height, rows.width, of.step)
    return checks.made(EnvironmentMap, radiance=radiance, peak=float(radiance.max()), replaced=None, notes=())


def _rmse(image: np.ndarray, sphere: np.ndarray | None) -> float | None:
    assert sphere is not None
    return relative_rmse(image, sphere) if sphere.any() else None


def _rows_of(lights: Lights) -> list[dict[str, float]]:
    names = [f"to_light_{axis}" for axis in "xyz"] + [f"flux_{channel}" for channel in ("red", "green", "blue")]
    values = np.concatenate([lights.direction.astype(np.float64), lights.flux], axis=1)
    return [dict(zip(names, light, strict=True)) for light in values.tolist()]


def _keep(row: Row, kind: str, path: str, write: Any) -> None:
    """Keep what ``write`` writes in memory: only the client can write to the catalog's folder."""
    with tempfile.TemporaryDirectory(prefix="lightdome-") as folder:
        written = Path(folder) / Path(path).name
        write(written)
        row.files[path] = written.read_bytes()
    row.values[f"{kind}_file"] = path
