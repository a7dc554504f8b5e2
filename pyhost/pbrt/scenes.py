"""The diffuse sphere as scenes for PBRT version 3 or 4, which ports of PBRT read too.

The scene matches lightdome's exactly. Its camera looks along -z, with +x to the right and +y up; the surface has direct
light only; and PBRT takes all samples of a pixel at its centre, where lightdome takes the normal. So both programs
estimate the same integral. What PBRT sees of the map next to the sphere is masked when its image is read.

The map differs by version. PBRT-v3 reads latitude-longitude maps as they are, but interpolates between pixels, where
lightdome and PBRT-v4 treat each pixel as constant. PBRT-v4 needs an equal-area square (see
:mod:`lightdome.pbrt.equal_area`) and renders with spectra: an RGB radiance becomes a smooth spectrum, and the film
turns it back. White comes back exactly; the weak channels of a strong colour were measured up to 0.8 % too dark, and
noisier than the rest.

The sampler is PBRT-v4's best, zsobol, if the number of samples is a power of two, and Halton for other numbers. In
PBRT-v3, only Halton can keep to the centres of pixels.

Source: the file formats at https://pbrt.org/fileformat-v3 and https://pbrt.org/fileformat-v4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .. import checks
from ..disc import check_resolution
from ..files import replacing
from ..maps.envmap import EnvironmentMap
from ..maps.images import write_image
from ..names import SEED
from .equal_area import to_equal_area

VERSIONS = (3, 4)
MAPS = {3: "map_v3_latlong.pfm", 4: "map_v4_equalarea.exr"}
# Version 3 reads and writes .exr pixels in 16 bits, but .pfm in full precision. Its port cannot write .pfm.
IMAGE_SUFFIX = {3: ".pfm", 4: ".exr"}
TEMPLATE = {
    3: """\
# lightdome: a diffuse unit sphere under an environment map, for PBRT-v3{remark}
Scale -1 1 1
LookAt 0 0 10  0 0 0  0 1 0
Camera "orthographic" "float screenwindow" [-1 1 -1 1]
Film "image" "string filename" ["{image}"]
     "integer xresolution" [{resolution}] "integer yresolution" [{resolution}]
Sampler "halton" "integer pixelsamples" [{spp}] "bool samplepixelcenter" ["true"]
PixelFilter "box" "float xwidth" [0.5] "float ywidth" [0.5]
Integrator "path" "integer maxdepth" [1]

WorldBegin
AttributeBegin
  # The map's up is +z, ours is +y.
  Rotate 90 1 0 0
  Scale 1 1 -1
  LightSource "infinite" "string mapname" ["{map}"]
AttributeEnd
Material "matte" "rgb Kd" [{albedo!r} {albedo!r} {albedo!r}]
Shape "sphere" "float radius" [1]
WorldEnd
""",
    4: """\
# lightdome: a diffuse unit sphere under an environment map, for PBRT-v4{remark}
Option "disablepixeljitter" true
Scale -1 1 1
LookAt 0 0 10  0 0 0  0 1 0
Camera "orthographic" "float screenwindow" [-1 1 -1 1]
Film "rgb" "string filename" ["{image}"] "bool savefp16" [false]
     "integer xresolution" [{resolution}] "integer yresolution" [{resolution}]
Sampler "{sampler}" "integer pixelsamples" [{spp}] "integer seed" [{seed}]
PixelFilter "box" "float xradius" [0.5] "float yradius" [0.5]
Integrator "path" "integer maxdepth" [1]

WorldBegin
AttributeBegin
  # The map's up is +z, ours is +y.
  Rotate 90 1 0 0
  Scale 1 1 -1
  LightSource "infinite" "string filename" ["{map}"]
AttributeEnd
Material "diffuse" "rgb reflectance" [{albedo!r} {albedo!r} {albedo!r}]
Shape "sphere" "float radius" [1]
""",
}


@dataclass(frozen=True)
class Scene:
    """A scene file for PBRT ``version``; the radiance is its image times 2^``exponent``."""

    path: Path
    version: int
    spp: int
    resolution: int
    exponent: int = 0


def scene_text(
    version: int, spp: int, resolution: int = 511, albedo: float = 1.0, seed: int = SEED, exponent: int = 0
) -> str:
    """The scene file for PBRT ``version`` (3 or 4) with ``spp`` samples per pixel and a map scaled by 2^-``exponent``.

    ``seed`` counts modulo 2^31, and only in version 4; version 3 has no seed. Raises
    :class:`LightdomeError` for an albedo outside 0 to 1 and for other numbers out of range.
    """
    resolution = check_resolution(resolution)
    version = checks.whole("the version of PBRT", version, *VERSIONS)
    spp = checks.whole("samples per pixel", spp, 1, 2**31 - 1)
    seed = checks.whole("a seed", seed, 0, 2**64 - 1)
    exponent = checks.whole("the exponent", exponent, -1000, 1000)
    albedo = checks.real("a PBRT scene's albedo", albedo, "a number from 0 to 1 (--albedo)", 0, 1)
    return TEMPLATE[version].format(
        remark=f"\n# Multiply its image by 2^{exponent}." if exponent else "",
        map=MAPS[version],
        image=f"sphere_{spp}spp{IMAGE_SUFFIX[version]}",
        resolution=resolution,
        spp=spp,
        albedo=albedo,
        seed=seed % 2**31,
        sampler=sampler_name(spp),
    )


def sampler_name(spp: int) -> str:
    """PBRT-v4's sampler: zsobol is the best, but it rounds the number of samples down to a power of two."""
    return "halton" if spp & (spp - 1) else "zsobol"


def write_scenes(
    folder: str | Path,
    envmap: EnvironmentMap,
    spp: Sequence[int],
    resolution: int = 511,
    albedo: float = 1.0,
    seed: int = SEED,
    versions: Sequence[int] = VERSIONS,
) -> list[Scene]:
    """Write the maps, and a scene for each of ``versions`` and ``spp``, into ``folder``, which must exist.

    Scenes name their map without a folder, so the whole folder can be moved. See :func:`scene_text` for the arguments
    and errors; also raises :class:`LightdomeError` if a file cannot be written.
    """
    folder = checks.path(folder)
    checks.instance("the map", envmap, EnvironmentMap)
    spp = sorted(set(checks.wholes("samples per pixel", spp, 1, 2**31 - 1)))
    versions = checks.wholes("versions of PBRT", versions, *VERSIONS)
    # PBRT sums pixels in plain float32, after factors of several thousand, so keep them far from its limits.
    exponent = int(np.frexp(envmap.peak)[1])
    exponent = exponent if abs(exponent) > 30 else 0
    scenes, texts = [], []
    for version in versions:
        for count in spp:
            texts.append(scene_text(version, count, resolution, albedo, seed, exponent))
            path = folder / f"sphere_v{version}_{count}spp.pbrt"
            scenes.append(Scene(path, version, count, resolution, exponent))
    radiance = np.ldexp(envmap.radiance, -exponent) if exponent else envmap.radiance
    for version in versions:
        write_image(folder / MAPS[version], to_equal_area(radiance) if version == 4 else _readable(radiance))
    for scene, text in zip(scenes, texts, strict=True):
        with replacing(scene.path) as path:
            path.write_text(text, encoding="ascii")
    return scenes


def _readable(radiance: np.ndarray) -> np.ndarray:
    """``radiance`` for a .pfm whose first byte is not white space, which pbrt-r3 would take for part of the header.

    That byte is the lowest of red at the bottom left, so at most five steps in its last digit are enough.
    """
    result = radiance.astype("<f4")
    while result[-1, 0, :1].tobytes()[0] in b"\t\n\v\f\r ":
        result[-1, 0, 0] = np.nextafter(result[-1, 0, 0], np.float32(np.inf))
    return result
