"""Files of lights for other programs: tables, scenes of renderers, and scenes of tools for artists.

Each format holds directional lights in its program's own axes and units, and states both at the top. The strength of
such a light is the irradiance of a surface that faces it. That is the light's flux, in the map's unit: radiance x
steradian. A map's radiance has no absolute unit; where a program expects lux, one unit of radiance is taken as one
cd/m^2.

- csv, json: +y is up, and directions point towards the lights; fluxes may have float64's range
- pbrt: ``LightSource "distant"``, for PBRT-v3 and PBRT-v4; +y is up
- mitsuba: ``<emitter type="directional">``; +y is up, and directions point away from the lights
- gltf: ``KHR_lights_punctual``; +y is up, and a light shines along the -z of its node
- usda: ``DistantLight`` of angle 0, normalised; +y is up, and a light shines along its -z
- blender: a script that adds sun lamps; +z is up, (x, y, z) becomes (x, -z, y), and a lamp shines along its -z

Sources: https://pbrt.org/fileformat-v3, https://pbrt.org/fileformat-v4,
https://mitsuba.readthedocs.io (plug-in ``directional``), KHR_lights_punctual in
https://github.com/KhronosGroup/glTF, https://openusd.org/release/api/class_usd_lux_light_a_p_i.html,
https://docs.blender.org/api/current/bpy.types.SunLight.html.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from .. import __version__, checks
from ..errors import LightdomeError
from ..files import replacing
from ..float_range import LARGEST
from ..names import LIGHT_FORMATS
from .lights import Lights

CSV_HEADER = "to_light_x,to_light_y_up,to_light_z,irradiance_red,irradiance_green,irradiance_blue"
AXES = "right-handed, +y is up"
OF = "of a surface that faces the light, in the map's radiance x steradian"
LUX = f"color x intensity is the irradiance {OF}, or lux if its radiance is in cd/m^2"


def write_lights(path: str | Path, lights: Lights, format: str | None = None) -> None:
    """Write the lights as ``format``, one of :data:`lightdome.names.LIGHT_FORMATS`; by default the suffix decides.

    Lights without flux are skipped, and so are those whose flux is 0 in the program's float32. Numbers have nine
    digits, as many as a float32 needs. Raises :class:`LightdomeError` if neither ``format`` nor the suffix says which
    format, if no light has flux, if a flux is beyond float32 and the format is not csv or json, or if the file cannot
    be written.
    """
    path = checks.path(path)
    checks.instance("the lights", lights, Lights)
    name = light_format(path, format)
    flux = lights.flux
    if name not in ("csv", "json"):
        if not (flux <= LARGEST).all():
            raise LightdomeError(
                f"a light is stronger than the {LARGEST:.2g} that the format {name} can hold;"
                " scale the map down and the image up"
            )
        flux = flux * (flux.astype(np.float32) > 0)
    lit = flux.any(axis=1)
    if not lit.any():
        raise LightdomeError(f"cannot write {path}: there is no light with flux")
    text = _TEXT[name](lights.direction[lit].astype(np.float64), flux[lit])
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="ascii")


def write_csv(path: str | Path, lights: Lights) -> None:
    """Write one light per line, under a line of names: the unit vector towards the light, and its flux.

    This is :func:`write_lights` with the format csv.
    """
    write_lights(path, lights, "csv")


def write_pbrt(path: str | Path, lights: Lights) -> None:
    """Write the lights as ``distant`` lights, in a file that scenes of PBRT-v3 and PBRT-v4 can include.

    ``Include "lights.pbrt"`` in the world block, outside any transformation if +y is up there. Version 4 takes the
    three numbers of ``L`` as an RGB in the scene's colour space. This is :func:`write_lights` with the format pbrt.
    """
    write_lights(path, lights, "pbrt")


def light_format(path: Path, format: str | None) -> str:
    """``format``, or the one whose suffix ``path`` has; raises :class:`LightdomeError` where there is none."""
    if format is not None:
        return checks.choice("format of lights", format, LIGHT_FORMATS)
    for name, suffix in LIGHT_FORMATS.items():
        if path.suffix.lower() == suffix:
            return name
    raise LightdomeError(
        f"the suffix of {path} names no format of lights; end the name in one of {', '.join(LIGHT_FORMATS.values())},"
        f" or give the format (--format), one of {', '.join(LIGHT_FORMATS)}"
    )


# ---- each format: directions towards the lights (N, 3) and fluxes (N, 3), float64, to text ----


def _csv(direction: np.ndarray, flux: np.ndarray) -> str:
    rows = [f"{_join(d, ',')},{_join(f, ',')}" for d, f in zip(direction, flux, strict=True)]
    return "\n".join([CSV_HEADER, *rows]) + "\n"


def _json(direction: np.ndarray, flux: np.ndarray) -> str:
    head = {
        "generator": f"lightdome {__version__}",
        "axes": f"{AXES}; to_light is the unit vector from the scene towards the light",
        "units": f"irradiance_rgb is that {OF}",
    }
    rows = [
        f"    {json.dumps({'to_light': _floats(d), 'irradiance_rgb': _floats(f)})}"
        for d, f in zip(direction, flux, strict=True)
    ]
    return json.dumps(head, indent=2)[:-2] + ',\n  "lights": [\n' + ",\n".join(rows) + "\n  ]\n}\n"


def _pbrt(direction: np.ndarray, flux: np.ndarray) -> str:
    lines = [
        "# lightdome: directional lights for PBRT-v3 and PBRT-v4; +y is up.",
        "# L is the irradiance of a surface that faces the light. The scene must start with Scale -1 1 1.",
    ]
    lines += [
        f'LightSource "distant" "point3 from" [{_join(d)}] "point3 to" [0 0 0] "rgb L" [{_join(f)}]'
        for d, f in zip(direction, flux, strict=True)
    ]
    return "\n".join(lines) + "\n"


def _mitsuba(direction: np.ndarray, flux: np.ndarray) -> str:
    lines = [
        '<?xml version="1.0" encoding="utf-8"?>',
        f"<!-- lightdome: directional lights for Mitsuba 3; {AXES}. direction points away from the light,",
        f"     irradiance is that {OF}. -->",
        '<scene version="3.0.0">',
    ]
    for d, f in zip(-direction, flux, strict=True):
        x, y, z = _join(d).split()
        lines += [
            '    <emitter type="directional">',
            f'        <vector name="direction" x="{x}" y="{y}" z="{z}"/>',
            f'        <rgb name="irradiance" value="{_join(f, ", ")}"/>',
            "    </emitter>",
        ]
    return "\n".join([*lines, "</scene>"]) + "\n"


def _gltf(direction: np.ndarray, flux: np.ndarray) -> str:
    intensity, color = _intensity_and_color(flux)
    names = [f"light {n}" for n in range(len(flux))]
    content = {
        "asset": {
            "version": "2.0",
            "generator": f"lightdome {__version__}",
            "extras": {"axes": f"{AXES}; a light shines along the -z of its node", "units": LUX},
        },
        "extensionsUsed": ["KHR_lights_punctual"],
        "extensions": {
            "KHR_lights_punctual": {
                "lights": [
                    {"name": name, "type": "directional", "color": _floats(c), "intensity": _floats([i])[0]}
                    for name, c, i in zip(names, color, intensity, strict=True)
                ]
            }
        },
        "nodes": [
            {"name": name, "rotation": _floats(np.roll(q, -1)), "extensions": {"KHR_lights_punctual": {"light": n}}}
            for n, (name, q) in enumerate(zip(names, _rotations(direction), strict=True))
        ],
        "scenes": [{"name": "lights", "nodes": list(range(len(flux)))}],
        "scene": 0,
    }
    return json.dumps(content, indent=1) + "\n"


def _usda(direction: np.ndarray, flux: np.ndarray) -> str:
    intensity, color = _intensity_and_color(flux)
    lines = [
        "#usda 1.0",
        "(",
        f'    doc = """lightdome: directional lights; {AXES}. A light shines along its -z;',
        f'    {LUX}."""',
        '    defaultPrim = "Lights"',
        '    upAxis = "Y"',
        ")",
        "",
        'def Xform "Lights"',
        "{",
    ]
    for n, (q, c, i) in enumerate(zip(_rotations(direction), color, intensity, strict=True)):
        lines += [
            f'    def DistantLight "Light_{n}"',
            "    {",
            "        float inputs:angle = 0",
            f"        color3f inputs:color = ({_join(c, ', ')})",
            f"        float inputs:intensity = {_join([i])}",
            "        bool inputs:normalize = 1",
            f"        quatd xformOp:orient = ({_join(q, ', ')})",
            '        uniform token[] xformOpOrder = ["xformOp:orient"]',
            "    }",
        ]
    return "\n".join([*lines, "}"]) + "\n"


_BLENDER = '''\
"""lightdome: directional lights as sun lamps. Run it in Blender's text editor, or by blender --python FILE.

+z is up, as everywhere in Blender: (x, y, z) of lightdome, where +y is up, is (x, -z, y) here. Colour x strength is
the irradiance {of}.
The lamps are in a collection of their own, and replace those that were in it.
"""

import bpy
from mathutils import Vector

NAME = "lightdome lights"
LIGHTS = [  # the unit vector towards the light, colour, strength
{rows}
]

collection = bpy.data.collections.get(NAME)
if collection is None:
    collection = bpy.data.collections.new(NAME)
    bpy.context.scene.collection.children.link(collection)
for lamp in [lamp for lamp in collection.objects if lamp.type == "LIGHT"]:
    bpy.data.lights.remove(lamp.data)  # and with it the lamp
for number, (direction, color, strength) in enumerate(LIGHTS):
    light = bpy.data.lights.new(f"light {{number:03}}", "SUN")
    light.color, light.energy, light.angle = color, strength, 0
    lamp = bpy.data.objects.new(light.name, light)
    lamp.rotation_mode = "QUATERNION"
    lamp.rotation_quaternion = Vector(direction).to_track_quat("Z", "Y")  # a lamp shines along its -z
    collection.objects.link(lamp)
'''


def _blender(direction: np.ndarray, flux: np.ndarray) -> str:
    intensity, color = _intensity_and_color(flux)
    rows = [
        f"    (({_join((x, -z, y), ', ')}), ({_join(c, ', ')}), {_join([i])}),"
        for (x, y, z), c, i in zip(direction, color, intensity, strict=True)
    ]
    return _BLENDER.format(of=OF, rows="\n".join(rows))


_TEXT: dict[str, Callable[[np.ndarray, np.ndarray], str]] = {
    "csv": _csv,
    "json": _json,
    "pbrt": _pbrt,
    "mitsuba": _mitsuba,
    "gltf": _gltf,
    "usda": _usda,
    "blender": _blender,
}


# ---- what they share ----


def _floats(values: Iterable[float]) -> list[float]:
    return [float(f"{value + 0.0:.9g}") for value in values]  # + 0.0 makes -0 a plain 0


def _join(values: Iterable[float], separator: str = " ") -> str:
    return separator.join(f"{value + 0.0:.9g}" for value in values)


def _intensity_and_color(flux: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The strongest channel (N,), and the colour (N, 3) whose strongest channel is 1; their product is ``flux``."""
    intensity = flux.max(axis=1)
    return intensity, flux / intensity[:, None]


def _rotations(direction: np.ndarray) -> np.ndarray:
    """Quaternions (N, 4), w first, that turn +z to ``direction`` the shortest way: (w, x, y, 0)."""
    x, y, z = direction.T
    across = np.hypot(x, y)
    half = np.arctan2(across, z) / 2
    axis = np.stack([-y, x, np.zeros_like(x)], axis=1)
    axis[across == 0] = (1, 0, 0)  # along the z-axis, any axis will do
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    return np.concatenate([np.cos(half)[:, None], np.sin(half)[:, None] * axis], axis=1)
