"""Check a folder of other programs' results, such as a class's hand-ins: a row per file, and a page with pictures.

The content of a file says what it is: an image, samples, lights, densities, or reflectances by angle. The name of an
image gives its number of samples: in ``sphere_64.pfm`` all pixels share 64 samples, in ``sphere_16spp.pfm`` each pixel
has 16 of its own. The name of a curve has "leaving" in it if the light leaves the material. The page is a single file
and needs no network.
"""

from __future__ import annotations

import base64
import html
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from .. import __version__
from ..disc import disc_mask
from ..errors import LightdomeError, one_line, shown
from ..fresnel.equations import fresnel
from ..maps.envmap import EnvironmentMap
from ..maps.images import READABLE, auto_exposure, tone_map
from ..maps.pictures import Picture
from ..opencl.device import Device
from ..progress import Progress
from .causes import Cause, Finding
from .files import PICTURES, read_rendered
from .fresnel import ANGLES, check_fresnel, read_curves
from .image import ImageCheck, Reference
from .lights import check_lights, read_lights
from .pdf import NAMES, check_pdf, read_pdf
from .places import places
from .samples import check_samples, read_samples
from .tables import TableCheck, read_table

COLUMNS = ("file", "kind", "agrees", "cause", "orientation", "relative_rmse", "verdict")
THUMBNAIL = 160  # pixels along the longer side
DOTS = 4096  # samples shown in a picture
Figure = tuple[str, str, bytes]  # a picture: its caption, MIME type and content


@dataclass(frozen=True)
class Row:
    """What was found in a file."""

    file: str
    kind: str
    agrees: bool | None
    verdict: str
    causes: tuple[Cause, ...] = ()
    orientation: str = ""
    relative_rmse: float | None = None
    figures: Sequence[Figure] = ()

    @property
    def answer(self) -> str:
        """Whether it agrees, in words."""
        return {True: "yes", False: "no", None: "cannot tell"}[self.agrees]

    @property
    def values(self) -> tuple[object, ...]:
        """The values of :data:`COLUMNS`."""
        causes = "; ".join(cause.name for cause in self.causes) or None
        return self.file, self.kind, self.answer, causes, self.orientation or None, self.relative_rmse, self.verdict


class FolderCheck:
    """Checks the files of a folder against one map; ``eta`` and ``leaving`` are for curves of reflectances."""

    def __init__(self, device: Device, envmap: EnvironmentMap, eta: float = 1.4, leaving: bool = False) -> None:
        self.device, self.envmap, self.eta, self.leaving = device, envmap, eta, leaving
        self.exposure = auto_exposure(envmap.radiance)

    @cached_property
    def reference(self) -> Reference:
        return Reference(self.device, self.envmap)

    def rows(self, folder: Path) -> list[Row]:
        """A row for each file under ``folder`` that may be a hand-in, sorted by name.

        A file that cannot be read has a row that says so. Raises :class:`LightdomeError` if there are no such files.
        """
        if not folder.is_dir():
            reason = "it is not a folder" if folder.exists() else "no such folder"
            raise LightdomeError(f"cannot read {folder}: {reason}")
        known = (*READABLE, *PICTURES, ".npz", ".csv")
        files = sorted(
            path
            for path in folder.rglob("*")
            if path.suffix.lower() in known
            and not any(part.startswith((".", "__MACOSX")) for part in path.relative_to(folder).parts)
        )
        if not files:
            raise LightdomeError(
                f"{folder} has no file that can be checked: expected names ending in {', '.join(known)}"
            )
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
        except Exception as error:  # one file must not stop the check of the others
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
            return _of_table(name, "densities", check_pdf(self.envmap, values), self._grey(values))
        words = ("flux", "irradiance", "to_light", "light")
        if any(word in column for word in words for column in table) or "light" in path.stem.lower():
            direction, flux = read_lights(path)
            check = check_lights(self.device, self.envmap, direction, flux)
            return _of_table(name, "lights", check, self._dots(direction))
        direction, *others = read_samples(path)
        check = check_samples(self.envmap, direction, *others)
        return _of_table(name, "samples", check, self._dots(direction))

    def _image(self, path: Path, name: str) -> Row:
        pixels, linear = read_rendered(path)
        number = re.search(r"_(\d{1,9})(spp)?(?:\D|$)", path.stem)
        count, per_pixel = (int(number[1]) or None, bool(number[2])) if number else (None, False)
        check = self.reference.check(pixels, count, per_pixel, linear)
        exposure = auto_exposure(check.exact)
        figures = [
            _png("image", tone_map(_black_outside(check.image), exposure)),
            _png("exact", tone_map(_black_outside(check.exact), exposure)),
            _png("blue: too dark, red: too bright", _error_colours(check)),
        ]
        return _row(name, "image", check, check.relative_rmse, figures)

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
        return _of_table(name, "reflectances", check, ("grey: exact", "image/svg+xml", _plot(lines)))

    def _dots(self, direction: np.ndarray) -> Figure:
        """The map, reduced, with white dots where the file's directions point."""
        picture = _small(tone_map(self.envmap.radiance, self.exposure)) // 2
        height, width = picture.shape[:2]
        good = np.isfinite(direction).all(axis=1) & direction.any(axis=1)
        v, u = places(direction[good][:DOTS].astype(np.float64), height, width)
        y, x = v.astype(int), u.astype(int)
        for down, across in np.ndindex(2, 2):
            picture[np.minimum(y + down, height - 1), (x + across) % width] = 255
        return _png("directions in the map", picture)

    def _grey(self, values: np.ndarray) -> Figure:
        grey = np.repeat(np.nan_to_num(np.maximum(values, 0.0), posinf=0)[..., None], 3, axis=2)
        return _png("densities", tone_map(grey, auto_exposure(grey)))


def _of_table(name: str, kind: str, check: TableCheck, figure: Figure) -> Row:
    rmse = check.details.get("relative_rmse")
    return _row(name, kind, check, rmse if isinstance(rmse, float) else None, [figure])


def _row(name: str, kind: str, check: Finding, rmse: float | None, figures: Sequence[Figure]) -> Row:
    return Row(name, kind, check.agrees, check.verdict, check.causes, check.orientation, rmse, figures)


# ---- Pictures ----


def _png(caption: str, pixels: np.ndarray) -> Figure:
    return caption, "image/png", Picture(_small(pixels))._repr_png_()


def _small(pixels: np.ndarray) -> np.ndarray:
    """The picture with at most :data:`THUMBNAIL` pixels per side, means over square blocks."""
    step = -(-max(pixels.shape[:2]) // THUMBNAIL)
    height, width = (n // step * step or n for n in pixels.shape[:2])
    if step == 1 or min(pixels.shape[:2]) < step:
        return pixels
    blocks = pixels[:height, :width].reshape(height // step, step, width // step, step, 3)
    return np.rint(blocks.mean(axis=(1, 3))).astype(np.uint8)


def _black_outside(image: np.ndarray) -> np.ndarray:
    return np.where(disc_mask(len(image))[..., None], np.maximum(image, 0), 0)


def _error_colours(check: ImageCheck) -> np.ndarray:
    """The mean error of the channels as a colour: blue is too dark, red too bright, and white right."""
    inside = disc_mask(len(check.exact))
    error = np.where(inside, (check.image - check.exact).mean(axis=2), 0)
    most = float(np.percentile(np.abs(error[inside]), 99.5)) or 1.0
    share = np.clip(error / most, -1, 1)
    red, blue = np.maximum(share, 0), np.maximum(-share, 0)
    colours = np.stack([1 - blue, 1 - red - 0.6 * blue, 1 - red], axis=2)
    return np.where(inside[..., None], np.rint(255 * colours), 0).astype(np.uint8)


def _plot(lines: Sequence[tuple[np.ndarray, np.ndarray, str]]) -> bytes:
    """Curves over 0 to 90 degrees, with values from 0 to 1, as SVG."""
    paths = []
    for x, y, colour in lines:
        at = np.isfinite(x) & np.isfinite(y)
        across, up = x[at] * (160 / 90), 110 - 100 * np.clip(y[at], -0.1, 1.1)
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(across, up, strict=True))
        paths.append(f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.5"/>')
    frame = '<rect width="160" height="120" fill="#fff"/><path d="M0 10H160M0 110H160" stroke="#ddd"/>'
    size = 'width="160" height="120" viewBox="0 0 160 120"'
    return f'<svg xmlns="http://www.w3.org/2000/svg" {size}>{frame}{"".join(paths)}</svg>'.encode()


# ---- The page ----

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
    """The rows as one HTML page that includes its pictures."""
    counts = {agrees: sum(row.agrees is agrees for row in rows) for agrees in (True, False, None)}
    summary = f"{len(rows)} files: {counts[True]} agree, {counts[False]} do not, {counts[None]} undecided"
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
    return (
        f'<tr><td class="file">{html.escape(row.file)}<br><span class="where">{row.kind}</span>'
        f'<td><span class="{row.answer.split()[0]}">{row.answer}</span>'
        f"<td>{'<br>'.join(_explained(row))}"
        f"<td>{''.join(_figure(*figure) for figure in row.figures)}</tr>"
    )


def _explained(row: Row) -> Iterator[str]:
    yield html.escape(row.verdict)
    for cause in row.causes:
        of = f"{cause.name}: " if len(row.causes) > 1 else ""
        yield f'<span class="where">Seen: {html.escape(of + cause.seen)}.</span>'
        yield f'<span class="where">Look: {html.escape(of + cause.where)}.</span>'


def _figure(caption: str, kind: str, content: bytes) -> str:
    source = f"data:{kind};base64,{base64.b64encode(content).decode()}"
    told = html.escape(caption)
    return f'<figure><img src="{source}" alt="{told}"><figcaption>{told}</figcaption></figure>'
