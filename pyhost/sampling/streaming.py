"""Samples of a map that stays in its file: only bands of its rows are in memory, however large it is.

The CDFs over rows need only the sums of every row, so the file is read once, band by band, and only the sums are
kept. These CDFs give the rows that the samples fall into. Only those rows are read again, and get CDFs of their own.
The samples are those of :meth:`lightdome.Distribution.sample`, bit for bit.
Kernels: those of :mod:`lightdome.sampling.distribution`, and ``choose_rows.cl``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from .. import __version__, checks
from ..errors import LightdomeError
from ..maps.envmap import EnvironmentMap, Inspection, Replaced
from ..maps.geometry import row_angles
from ..maps.images import ImageRows
from ..names import SEED, WITHIN
from ..opencl import memory
from ..opencl.device import Device
from ..opencl.memory import DeviceArray
from ..progress import Progress
from .cdf import MapCDF, build_marginal_cdfs, build_row_cdfs
from .device_map import DeviceMap, range_scale, upload_sines
from .draw import BLACK, MAX_COUNT, OUTPUTS, Points, drawn, given_points, is_guided, sequence_points
from .samples import Samples
from .strips import strip_bits


class _Chosen(NamedTuple):
    """For N samples: the ``row``, the number ``across`` that picks a pixel in it, and the ``place`` down the row."""

    row: np.ndarray  # uint32
    across: np.ndarray  # uint64, in units of 2^-64
    place: np.ndarray  # uint32, in units of 2^-32


# Work-items per group. If left to choose, PoCL picks a different size for nearly every count, and compiles for each.
GROUP = 64


def sample_file(
    device: Device,
    image: ImageRows,
    counts: Sequence[int],
    seed: int = SEED,
    sequence: str = "independent",
    *,
    within: str = "centre",
    sanitize: bool | str = False,
    report: Callable[[Replaced], None] | None = None,
) -> list[Samples]:
    """A set of samples of the map in a file for each of ``counts``, as ``Distribution.sample`` draws them.

    All of the file is read once, then the rows that hold samples. If the map's peak lies outside 2^-60 to 2^60, all of
    it is read twice.

    ``within`` is that of ``Distribution.sample``, ``sanitize`` that of :meth:`lightdome.EnvironmentMap.read`;
    ``report`` is called with what was replaced, if anything was. Raises :class:`LightdomeError` where the file cannot
    be read, holds bad pixels that are not to be replaced, or is black; and for what ``Distribution.sample`` refuses.
    """
    checks.instance("the device", device, Device)
    checks.instance("the image", image, ImageRows)
    counts = checks.wholes("counts", counts, 0, MAX_COUNT)
    checks.choice("place within a pixel", within, WITHIN)
    points = [sequence_points(count, seed, sequence) for count in counts]
    memory.check_room(device, 12 * sum(counts))  # as for a map in memory
    inspection = Inspection(sanitize, image.largest)
    row_sums = _row_sums(device, image, 1.0, inspection)
    inspection.refuse_bad_pixels(str(image.path))
    scale = range_scale(inspection.peak)
    if scale != 1:
        row_sums = _row_sums(device, image, scale, Inspection(sanitize, image.largest))
    sin_theta = upload_sines(device, row_angles(image.height))
    marginal, strips, total = build_marginal_cdfs(device, memory.upload(device, row_sums), sin_theta)
    if total == 0:
        raise LightdomeError(BLACK)
    if report is not None and (replaced := inspection.replaced(image.height, total / scale)):
        report(replaced)
    chosen = [_choose_rows(device, marginal, strips, of_set) for of_set in points]
    samples = _draw(
        device,
        image,
        Inspection(sanitize, image.largest),
        _Chosen(*map(np.concatenate, zip(*chosen, strict=True))),
        scale,
        strips,
        total,
        within,
    )
    shape = (image.height, image.width)
    sets = (np.split(array, np.cumsum(counts)[:-1]) for array in samples.values())
    return [
        checks.made(
            Samples,
            **dict(zip(samples, of_set, strict=True)),
            map_shape=shape,
            sequence=sequence,
            seed=seed,
            version=__version__,
            within=within,
        )
        for of_set in zip(*sets, strict=True)
    ]


def _band(
    device: Device, image: ImageRows, rows: np.ndarray, radiance: np.ndarray, peak: float, scale: float
) -> DeviceMap:
    """Some rows of the map in a file, as a map on the device."""
    envmap = checks.made(EnvironmentMap, radiance=radiance, peak=peak, replaced=None, notes=())
    return DeviceMap(device, envmap, scale, row_angles(image.height)[rows], np.pi / image.height)


def _row_sums(device: Device, image: ImageRows, scale: float, inspection: Inspection) -> np.ndarray:
    """The sums of every row of a file, (S, H) double words; ``inspection`` sees its values."""
    sums = np.empty((1 << strip_bits(image.width), image.height, 2), np.float32)
    done = 0
    with Progress("reading the map") as progress:
        for rows, radiance in image.read(np.arange(image.height)):
            mended = inspection.mended(radiance, int(rows[0]))
            built = build_row_cdfs(_band(device, image, rows, mended, inspection.peak, scale))
            sums[:, rows] = memory.download(device, built.sums)
            done += len(rows)
            progress.update(done / image.height)
    return sums


def _choose_rows(device: Device, marginal: DeviceArray, strips: DeviceArray, points: Points) -> _Chosen:
    row, across, place = (memory.empty(device, points.count, kind) for kind in (np.uint32, np.uint64, np.uint32))
    device.launch(
        "sampling/choose_rows",
        (points.count,),
        stage="search",
        defines=points.defines,
        group=GROUP,
        marginal_cdf=marginal,
        strips=strips,
        strip_bits=strips.shape[0].bit_length() - 1,
        height=marginal.shape[1],
        count=points.count,
        seed=points.key,
        generator=points.generator,
        row=row,
        across=across,
        place=place,
    )
    return _Chosen(*(memory.download(device, array) for array in (row, across, place)))


def _point_in_step(step: np.ndarray, count: int, place: np.ndarray) -> np.ndarray:
    """The point that picks ``step`` of a CDF of ``count`` equal steps, at ``place`` in the step, in units of 2^-64.

    Places are fractions of 2^32, as ``within_pixel.clh`` computes them.
    """
    begin, end = ((((step + i).astype(np.uint64) << np.uint64(32)) + (count - 1)) // count for i in range(2))
    return (begin << np.uint64(32)) + place * (end - begin)


def _draw(
    device: Device,
    image: ImageRows,
    inspection: Inspection,
    chosen: _Chosen,
    scale: float,
    strips: DeviceArray,
    total: float,
    within: str,
) -> dict[str, np.ndarray]:
    """All OUTPUTS of samples whose rows are known."""
    row, count = chosen.row, len(chosen.row)
    result: dict[str, np.ndarray] = {name: np.empty((count, *shape), kind) for name, (shape, kind) in OUTPUTS.items()}
    order = np.argsort(row)
    sorted_row = row[order]
    done = 0
    guided: list[bool] = []
    with Progress("reading the chosen rows") as progress:
        for rows, pixels in image.read(np.unique(row)):
            # CDFs over these rows alone, all equally likely: `down` picks the row that is already known.
            mended = inspection.mended(pixels)
            band = _band(device, image, rows, mended, inspection.peak, scale)
            even = np.tile(np.arange(1, len(rows) + 1, dtype=np.uint32), (strips.shape[0], 1))
            cdf = MapCDF(device, build_row_cdfs(band).cdf, memory.upload(device, even), strips, total)
            first, end = np.searchsorted(sorted_row, [rows[0], rows[-1] + 1])
            index = order[first:end]
            down = _point_in_step(np.searchsorted(rows, row[index]), len(rows), chosen.place[index])
            points = given_points(device, np.stack([chosen.across[index], down], axis=1))
            samples = drawn(band, cdf, points, within=within)
            samples["pixel"][:, 1] = rows[samples["pixel"][:, 1]]
            guided.append(is_guided(points.count, band))
            for name, values in samples.items():
                result[name][index] = values
            done += len(index)
            progress.update(done / count)
    # Each band has decided for itself; this is the decision for all of them.
    if any(guided):
        many = f"in {sum(guided)} of {len(guided)} bands of rows, enough samples to pay for them"
        device.decisions.use("guide tables", many)
    else:
        device.decisions.skip("guide tables", "no band of rows has enough samples to pay for them")
    return result
