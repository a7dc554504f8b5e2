"""A folder of what others made, a class's hand-ins, checked file by file: a row each, and a page with pictures of all.

What a file is, its content says: an image, samples, lights, densities, or reflectances by angle. The number of samples
of an image is read from its name: ``sphere_64.pfm`` has 64 that all pixels share, ``sphere_16spp.pfm`` 16 per pixel. A
curve of light that leaves the material has "leaving" in its name. The page is one file that needs no network.
"""

from __future__ import annotations

import base64
import html
import re
import struct
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from .. import __version__
from ..disc import disc_mask
from ..errors import LightdomeError, one_line, shown
from ..fresnel.equations import fresnel
from ..maps.envmap import EnvironmentMap
from ..maps.images import READABLE, auto_exposure, tone_map
from ..opencl.device import Device
from ..progress import Progress
from .causes import Cause
from .files import PICTURES, read_rendered
from .fresnel import ANGLES, check_fresnel, read_curves
from .image import ImageCheck, Reference
from .lights import check_lights, read_lights
from .pdf import NAMES, check_pdf, read_pdf
from .places import places
from .samples import check_samples, read_samples
from .tables import TableCheck, read_table

COLUMNS = ("file", "kind", "agrees", "cause", "orientation", "relative_rmse", "verdict")
THUMBNAIL = 160  # pixels, of the longer side
DOTS = 4096  # samples that a picture shows


@dataclass(frozen=True)
class Row:
    """What was found in a file: ``picture`` and ``error`` are PNG or SVG for the page, with their types."""

    file: str
    kind: str
    agrees: bool | None
    verdict: str
    cause: Cause | None = None
    orientation: str = ""
    relative_rmse: float | None = None
    pictures: list[tuple[str, str, bytes]] = field(default_factory=list)  # what it shows, type, content

    @property
    def values(self) -> tuple[object, ...]:
        """In the order of :data:`COLUMNS`."""
        agrees = {True: "yes", False: "no", None: "cannot tell"}[self.agrees]
        cause = self.cause and self.cause.name
        return self.file, self.kind, agrees, cause, self.orientation or None, self.relative_rmse, self.verdict


class FolderCheck:
    """Checks the files of a folder against one map; ``eta`` and ``leaving`` are for curves of reflectances."""

    def __init__(self, device: Device, envmap: EnvironmentMap, eta: float = 1.4, leaving: bool = False) -> None:
        self.device, self.envmap, self.eta, self.leaving = device, envmap, eta, leaving
        self.exposure = auto_exposure(envmap.radiance)

    @cached_property
    def reference(self) -> Reference:
        return Reference(self.device, self.envmap)

    def rows(self, folder: Path) -> list[Row]:
        """A row for each file under ``folder`` that may be a hand-in, by name.

        Raises :class:`LightdomeError` where there is none; a file that cannot be read costs its own row alone.
        """
        if not folder.is_dir():
            raise LightdomeError(f"cannot read {folder}: there is no such folder")
        known = (*READABLE, *PICTURES, ".npz", ".csv")
        files = sorted(p for p in folder.rglob("*") if p.suffix.lower() in known and not p.name.startswith("."))
        if not files:
            raise LightdomeError(f"{folder} holds no file that can be checked: none ends in {', '.join(known)}")
        result = []
        with Progress("checking files") as progress:
            for n, path in enumerate(files):
                result.append(self._row(path, shown(path.relative_to(folder))))
                progress.update((n + 1) / len(files))
        return result

    def _row(self, path: Path, name: str) -> Row:
        try:
            return self._checked(path, name)
        except LightdomeError as error:
            return Row(name, "unreadable", None, shown(str(error).replace(str(path), path.name)))
        except Exception as error:  # one file must not cost the others their rows
            return Row(name, "unreadable", None, f"the check failed: {type(error).__name__}: {one_line(error)}")

    def _checked(self, path: Path, name: str) -> Row:
        if path.suffix.lower() not in (".csv", ".npz"):
            return self._image(path, name)
        table = read_table(path)
        if any(column.startswith(ANGLES) for column in table):
            return self._fresnel(path, name)
        if "image" in table:
            return self._image(path, name)
        if any(key in table and table[key].ndim == 2 for key in NAMES):
            values, _ = read_pdf(path)
            return _of_table(name, "densities", check_pdf(self.envmap, values), [self._grey(values)])
        words = ("flux", "irradiance", "to_light", "light")
        if any(word in column for word in words for column in table) or "light" in path.stem.lower():
            direction, flux = read_lights(path)
            check = check_lights(self.device, self.envmap, direction, flux)
            return _of_table(name, "lights", check, [self._dots(direction)])
        direction, *others = read_samples(path)
        check = check_samples(self.envmap, direction, *others)
        return _of_table(name, "samples", check, [self._dots(direction)])

    def _image(self, path: Path, name: str) -> Row:
        pixels, linear = read_rendered(path)
        number = re.search(r"_(\d{1,9})(spp)?(?:\D|$)", path.stem)
        count, per_pixel = (int(number[1]) or None, bool(number[2])) if number else (None, False)
        if not np.isfinite(pixels).all():
            raise LightdomeError("the image has pixels that are NaN or infinite")
        check = self.reference.check(pixels, count, per_pixel, linear)
        exposure = auto_exposure(check.exact)
        pictures = [("image", "image/png", png(_small(tone_map(_black_outside(check.image), exposure))))]
        pictures += [("exact", "image/png", png(_small(tone_map(_black_outside(check.exact), exposure))))]
        pictures += [("blue too dark, red too bright", "image/png", png(_small(_error_colours(check))))]
        rmse = check.relative_rmse
        return Row(name, "image", check.agrees, check.verdict, check.cause, check.orientation, rmse, pictures)

    def _fresnel(self, path: Path, name: str) -> Row:
        theta, curves = read_curves(path)
        leaving = self.leaving or "leaving" in path.stem.lower()
        check = check_fresnel(theta, *curves, eta=self.eta, leaving=leaving)
        a, b = (self.eta, 1.0) if leaving else (1.0, self.eta)
        p, s = fresnel(np.minimum(theta, np.pi / 2), a, b)
        lines = [(np.degrees(theta), v, "#bbb") for v in ((p + s) / 2, p, s)]
        lines += [
            (np.degrees(theta), v, colour)
            for v, colour in zip(curves, ("#000", "#0072B2", "#D55E00"), strict=True)
            if v is not None
        ]
        return _of_table(name, "reflectances", check, [("grey: exact", "image/svg+xml", _plot(lines))])

    def _dots(self, direction: np.ndarray) -> tuple[str, str, bytes]:
        """The map, small, with white dots where the directions lie, as they are in the file."""
        picture = _small(tone_map(self.envmap.radiance, self.exposure)) // 2
        height, width = picture.shape[:2]
        good = np.isfinite(direction).all(axis=1) & direction.any(axis=1)
        v, u = places(direction[good][:DOTS].astype(np.float64), height, width)
        y, x = v.astype(int), u.astype(int)
        for down, across in np.ndindex(2, 2):
            picture[np.minimum(y + down, height - 1), (x + across) % width] = 255
        return "directions in the map", "image/png", png(picture)

    def _grey(self, values: np.ndarray) -> tuple[str, str, bytes]:
        grey = np.repeat(np.nan_to_num(np.maximum(values, 0.0), posinf=0)[..., None], 3, axis=2)
        return "densities", "image/png", png(_small(tone_map(grey, auto_exposure(grey))))


def _of_table(name: str, kind: str, check: TableCheck, pictures: list[tuple[str, str, bytes]]) -> Row:
    rmse = check.details.get("relative_rmse")
    rmse = float(rmse) if isinstance(rmse, int | float | np.floating) else None
    return Row(name, kind, check.agrees, check.verdict, check.cause, check.orientation, rmse, pictures)


# ---- pictures ----


def png(pixels: np.ndarray) -> bytes:
    """A PNG file of (H, W, 3) uint8."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        checked = kind + content
        return struct.pack(">I", len(content)) + checked + struct.pack(">I", zlib.crc32(checked))

    height, width = pixels.shape[:2]
    rows = np.concatenate([np.zeros((height, 1), np.uint8), pixels.reshape(height, -1)], axis=1)
    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", head)
        + chunk(b"IDAT", zlib.compress(rows.tobytes()))
        + chunk(b"IEND", b"")
    )


def _small(pixels: np.ndarray) -> np.ndarray:
    """At most :data:`THUMBNAIL` pixels a side: means of squares."""
    step = -(-max(pixels.shape[:2]) // THUMBNAIL)
    height, width = (n // step * step or n for n in pixels.shape[:2])
    if step == 1 or min(pixels.shape[:2]) < step:
        return pixels
    blocks = pixels[:height, :width].reshape(height // step, step, width // step, step, 3)
    return np.rint(blocks.mean(axis=(1, 3))).astype(np.uint8)


def _black_outside(image: np.ndarray) -> np.ndarray:
    return np.where(disc_mask(len(image))[..., None], np.maximum(image, 0), 0)


def _error_colours(check: ImageCheck) -> np.ndarray:
    """The image less the exact one, mean of the channels: blue is too dark, red too bright, white right."""
    inside = disc_mask(len(check.exact))
    error = np.where(inside, (check.image - check.exact).mean(axis=2), 0)
    most = float(np.percentile(np.abs(error[inside]), 99.5)) or 1.0
    share = np.clip(error / most, -1, 1)
    red, blue = np.maximum(share, 0), np.maximum(-share, 0)
    colours = np.stack([1 - blue, 1 - red - 0.6 * blue, 1 - red], axis=2)
    return np.where(inside[..., None], np.rint(255 * colours), 0).astype(np.uint8)


def _plot(lines: Sequence[tuple[np.ndarray, np.ndarray, str]]) -> bytes:
    """Curves from 0 to 90 degrees and from 0 to 1, as SVG."""
    paths = []
    for x, y, colour in lines:
        at = np.isfinite(x) & np.isfinite(y)
        across, up = x[at] * (160 / 90), 110 - 100 * np.clip(y[at], -0.1, 1.1)
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(across, up, strict=True))
        paths.append(f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.5"/>')
    frame = '<rect width="160" height="120" fill="#fff"/><path d="M0 10H160M0 110H160" stroke="#ddd"/>'
    size = 'width="160" height="120" viewBox="0 0 160 120"'
    return f'<svg xmlns="http://www.w3.org/2000/svg" {size}>{frame}{"".join(paths)}</svg>'.encode()


# ---- the page ----

STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; margin: 2rem auto; max-width: 76rem; padding: 0 1rem; color: #222; }
table { border-collapse: collapse; width: 100%; }
th, td { text-align: left; vertical-align: top; padding: .6rem .8rem; border-bottom: 1px solid #ddd; }
td.file { overflow-wrap: anywhere; min-width: 11rem; }
td:last-child { white-space: nowrap; }
.yes, .no, .cannot { border-radius: .3rem; padding: .1rem .5rem; white-space: nowrap; font-weight: 600; }
.yes { background: #d7f0df; color: #14532d; }
.no { background: #fbdcd3; color: #7c2d12; }
.cannot { background: #eee; color: #444; }
figure { display: inline-block; margin: 0 .6rem 0 0; }
figcaption, .where { color: #555; font-size: 13px; }
img { display: block; max-width: 8rem; }
"""


def page(rows: Sequence[Row], title: str) -> str:
    """The rows as one HTML page, pictures included."""
    counts = {agrees: sum(row.agrees is agrees for row in rows) for agrees in (True, False, None)}
    summary = f"{len(rows)} files: {counts[True]} agree, {counts[False]} do not, {counts[None]} cannot be told"
    body = "\n".join(_html_row(row) for row in rows)
    heading = html.escape(title)
    return f"""<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>{heading}</title>
<style>{STYLE}</style>
<h1>{heading}</h1>
<p>{summary}. Checked by lightdome {__version__}.</p>
<table>
<thead><tr><th>file<th>agrees<th>verdict<th>pictures</tr></thead>
<tbody>
{body}
</tbody>
</table>
</html>
"""


def _html_row(row: Row) -> str:
    word = {True: "yes", False: "no", None: "cannot tell"}[row.agrees]
    return (
        f'<tr><td class="file">{html.escape(row.file)}<br><span class="where">{row.kind}</span>'
        f'<td><span class="{word.split()[0]}">{word}</span>'
        f"<td>{'<br>'.join(_told(row))}"
        f"<td>{''.join(_figure(*picture) for picture in row.pictures)}</tr>"
    )


def _told(row: Row) -> Iterator[str]:
    yield html.escape(row.verdict)
    if row.cause:
        yield f'<span class="where">Seen: {html.escape(row.cause.seen)}.</span>'
        yield f'<span class="where">Where: {html.escape(row.cause.where)}.</span>'


def _figure(caption: str, kind: str, content: bytes) -> str:
    source = f"data:{kind};base64,{base64.b64encode(content).decode()}"
    told = html.escape(caption)
    return f'<figure><img src="{source}" alt="{told}"><figcaption>{told}</figcaption></figure>'
