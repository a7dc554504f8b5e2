"""Lights as files for other programs: their content, and how the program reads it, if it is installed."""

from __future__ import annotations

import ast
import csv
import json
import re
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from conventions import python_with
from helpers import LONG
from lightdome import reference
from lightdome.errors import LightdomeError
from lightdome.lighting.light_files import write_csv, write_lights, write_pbrt
from lightdome.lighting.lights import Lights
from lightdome.lighting.median_cut import median_cut
from lightdome.lighting.shade import shade
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.images import read_image
from lightdome.names import LIGHT_FORMATS
from lightdome.opencl.device import Device
from lightdome.pbrt.run import Pbrt, render_scene
from lightdome.pbrt.scenes import Scene
from lightdome.sampling.distribution import build_distribution

# Version 3 sums all lights; version 4 picks one per sample, so its image is noisy.
SCENE = {
    3: """\
Scale -1 1 1
LookAt 0 0 10  0 0 0  0 1 0
Camera "orthographic" "float screenwindow" [-1 1 -1 1]
Film "image" "string filename" ["image.pfm"] "integer xresolution" [64] "integer yresolution" [64]
Sampler "halton" "integer pixelsamples" [1] "bool samplepixelcenter" ["true"]
PixelFilter "box" "float xwidth" [0.5] "float ywidth" [0.5]
Integrator "directlighting" "string strategy" "all" "integer maxdepth" [1]
WorldBegin
Include "lights.pbrt"
Material "matte" "rgb Kd" [1 1 1]
Shape "sphere" "float radius" [1]
WorldEnd
""",
    4: """\
Option "disablepixeljitter" true
Scale -1 1 1
LookAt 0 0 10  0 0 0  0 1 0
Camera "orthographic" "float screenwindow" [-1 1 -1 1]
Film "rgb" "string filename" ["image.exr"] "bool savefp16" [false]
     "integer xresolution" [64] "integer yresolution" [64]
Sampler "zsobol" "integer pixelsamples" [128]
PixelFilter "box" "float xradius" [0.5] "float yradius" [0.5]
Integrator "path" "integer maxdepth" [1]
WorldBegin
Include "lights.pbrt"
Material "diffuse" "rgb reflectance" [1 1 1]
Shape "sphere" "float radius" [1]
""",
}


@pytest.fixture(scope="module")
def lights(device: Device, stiff: EnvironmentMap) -> Lights:
    return median_cut(build_distribution(device, stiff), 64)


def read_pbrt(path: Path) -> np.ndarray:
    """The ``distant`` lights, (N, 6): direction towards the light in PBRT's axes, and L."""
    number = r"([-+.\de]+)"
    triple = rf"\[{number} {number} {number}\]"
    pattern = re.compile(rf'LightSource "distant" "point3 from" {triple} "point3 to" {triple} "rgb L" {triple}')
    found = []
    for line in path.read_text().splitlines():
        if line.startswith("#"):
            continue
        match = pattern.fullmatch(line)
        assert match, line
        source, target, L = np.array(match.groups(), float).reshape(3, 3)
        found.append(np.concatenate([source - target, L]))
    return np.array(found)


def read_csv(path: Path) -> np.ndarray:
    with path.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    irradiance = [f"irradiance_{channel}" for channel in ("red", "green", "blue")]
    assert list(rows[0]) == ["to_light_x", "to_light_y_up", "to_light_z", *irradiance]
    return np.array([list(row.values()) for row in rows], float)


def read_json(path: Path) -> np.ndarray:
    content = json.loads(path.read_text())
    assert "+y is up" in content["axes"]
    assert "radiance x steradian" in content["units"]
    return np.array([[*light["to_light"], *light["irradiance_rgb"]] for light in content["lights"]])


def read_mitsuba(path: Path) -> np.ndarray:
    found = []
    for emitter in ElementTree.parse(path).getroot():
        assert (emitter.tag, emitter.get("type")) == ("emitter", "directional")
        vector, rgb = emitter
        assert (vector.get("name"), rgb.get("name")) == ("direction", "irradiance")
        away = [float(vector.get(axis)) for axis in "xyz"]
        found.append([*np.negative(away), *map(float, rgb.get("value").split(", "))])
    return np.array(found)


def turned(w: float, x: float, y: float, z: float) -> np.ndarray:
    """Where a quaternion takes +z, the place of a light that shines along -z."""
    assert w * w + x * x + y * y + z * z == pytest.approx(1, abs=1e-8)
    return np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])


def read_gltf(path: Path) -> np.ndarray:
    content = json.loads(path.read_text())
    lights = content["extensions"]["KHR_lights_punctual"]["lights"]
    found = []
    for number in content["scenes"][content["scene"]]["nodes"]:
        node = content["nodes"][number]
        light = lights[node["extensions"]["KHR_lights_punctual"]["light"]]
        assert light["type"] == "directional"
        assert max(light["color"]) == 1  # no channel may be above 1
        x, y, z, w = node["rotation"]
        found.append([*turned(w, x, y, z), *np.multiply(light["color"], light["intensity"])])
    return np.array(found)


def read_usda(path: Path) -> np.ndarray:
    text = path.read_text()
    assert 'upAxis = "Y"' in text
    colors, orients = (re.findall(rf"{name} = \((.*)\)", text) for name in ("color3f inputs:color", "orient"))
    intensities = re.findall(r"float inputs:intensity = (.*)", text)
    count = text.count("def DistantLight")
    assert count == text.count("inputs:angle = 0\n") == text.count("inputs:normalize = 1\n") == len(colors)
    return np.array(
        [
            [*turned(*map(float, orient.split(","))), *(float(c) * float(intensity) for c in color.split(","))]
            for orient, color, intensity in zip(orients, colors, intensities, strict=True)
        ]
    )


def read_blender(path: Path) -> np.ndarray:
    """From Blender's axes to ours: its +z is up, and its +y goes where our -z does."""
    (table,) = (
        node.value
        for node in ast.parse(path.read_text()).body
        if isinstance(node, ast.Assign) and node.targets[0].id == "LIGHTS"
    )
    lights = ast.literal_eval(table)
    return np.array([[x, z, -y, *np.multiply(color, strength)] for (x, y, z), color, strength in lights])


READ = {
    "csv": read_csv,
    "json": read_json,
    "pbrt": read_pbrt,
    "mitsuba": read_mitsuba,
    "gltf": read_gltf,
    "usda": read_usda,
    "blender": read_blender,
}
EACH = pytest.mark.parametrize("name", LIGHT_FORMATS)


def same(found: np.ndarray, lights: Lights, digits: float = 1e-8) -> None:
    """Assert that ``found`` (N, 6) are the lights: directions to float32's precision, fluxes to 1 +- ``digits``."""
    np.testing.assert_allclose(found[:, :3], lights.direction, rtol=0, atol=max(1e-7, digits))
    np.testing.assert_allclose(found[:, 3:], lights.flux, rtol=digits)


@EACH
def test_a_file_returns_the_lights(lights: Lights, tmp_path: Path, name: str) -> None:
    path = tmp_path / f"lights{LIGHT_FORMATS[name]}"
    write_lights(path, lights)
    same(READ[name](path), lights)
    write_lights(tmp_path / "named", lights, name)
    assert (tmp_path / "named").read_bytes() == path.read_bytes()


@EACH
def test_light_along_an_axis_is_exact(tmp_path: Path, name: str) -> None:
    """Up, down, and the direction in which an unrotated light shines."""
    lights = Lights(np.concatenate([np.eye(3), -np.eye(3)]), np.full((6, 3), 0.5))
    write_lights(tmp_path / "lights", lights, name)
    found = READ[name](tmp_path / "lights")
    np.testing.assert_allclose(found[:, :3], lights.direction, atol=1e-8)
    assert not re.search(r"-0(\.0+)?(?![.\de])", (tmp_path / "lights").read_text())


@EACH
def test_a_light_without_flux_is_left_out(tmp_path: Path, name: str) -> None:
    lights = Lights(np.eye(3, dtype=np.float32), np.array([[1.0, 2, 3], [0, 0, 0], [0, 0, 1]]))
    write_lights(tmp_path / "lights", lights, name)
    expected = [[1, 0, 0, 1, 2, 3], [0, 0, 1, 0, 0, 1]]
    np.testing.assert_allclose(READ[name](tmp_path / "lights"), expected, rtol=1e-8, atol=1e-8)
    with pytest.raises(LightdomeError, match="no light with flux"):
        write_lights(tmp_path / "none", Lights(np.eye(3), np.zeros((3, 3))), name)
    assert not (tmp_path / "none").exists()


@EACH
@pytest.mark.parametrize(("flux", "words"), [(1e39, "scale the map"), (1e-60, "no light with flux")])
def test_what_a_program_cannot_represent_is_refused(tmp_path: Path, name: str, flux: float, words: str) -> None:
    lights = Lights(np.eye(3)[:1], np.full((1, 3), flux))
    if name in ("csv", "json"):
        write_lights(tmp_path / "lights", lights, name)
        same(READ[name](tmp_path / "lights"), lights)
    else:
        with pytest.raises(LightdomeError, match=words):
            write_lights(tmp_path / "lights", lights, name)
        assert not list(tmp_path.iterdir())


def test_a_format_is_that_of_the_suffix_or_named(lights: Lights, tmp_path: Path) -> None:
    write_lights(tmp_path / "LIGHTS.JSON", lights)
    assert len(read_json(tmp_path / "LIGHTS.JSON")) == len(lights)
    for suffix in ("", ".glb"):
        with pytest.raises(LightdomeError, match="names no format of lights"):
            write_lights(tmp_path / f"lights{suffix}", lights)
    with pytest.raises(LightdomeError, match="unknown format of lights 'max'"):
        write_lights(tmp_path / "lights.json", lights, "max")


def test_formats_have_writers_of_their_own_names(lights: Lights, tmp_path: Path) -> None:
    for write, name in ((write_csv, "csv"), (write_pbrt, "pbrt")):
        write(tmp_path / "lights.txt", lights)
        same(READ[name](tmp_path / "lights.txt"), lights)


def test_a_missing_folder_is_named(lights: Lights, tmp_path: Path) -> None:
    for write in (write_csv, write_pbrt):
        with pytest.raises(LightdomeError, match="cannot write"):
            write(tmp_path / "nowhere" / "lights", lights)


# ---- the programs themselves ----


@pytest.mark.peer
def test_pbrt_draws_the_same_sphere(device: Device, tmp_path: Path, program: Pbrt) -> None:
    version = program.version
    # Mild colours: version 4 renders spectra, and saturated ones add noise.
    rng = np.random.default_rng(5)
    direction = rng.normal(0.3, 1, (64, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    lights = Lights(direction.astype(np.float32), rng.uniform(0.5, 1.5, (64, 3)) * rng.uniform(0.5, 1.5, (64, 1)))
    write_pbrt(tmp_path / "lights.pbrt", lights)
    (tmp_path / "scene.pbrt").write_text(SCENE[version])
    image = render_scene(program, Scene(tmp_path / "scene.pbrt", version, 64, 64), LONG)
    ours = shade(device, lights.direction, lights.flux, 64)
    assert reference.relative_rmse(image, ours) < {3: 1e-5, 4: 0.05}[version]
    np.testing.assert_allclose(image.mean(axis=(0, 1)), ours.mean(axis=(0, 1)), rtol={3: 1e-5, 4: 5e-3}[version])
    for turned in (image[::-1], image[:, ::-1], image.swapaxes(0, 1)):
        assert reference.relative_rmse(turned, ours) > 0.05


def ask(package: str, program: str, *arguments: object) -> object:
    """Run a Python program that needs ``package`` in its own process; returns its last line, read as JSON."""
    python = python_with(package)
    if python is None:
        pytest.skip(f"needs the package {package}, here or in a Python of LIGHTDOME_PEERS")
    command = [python, "-c", program, *map(str, arguments)]
    result = subprocess.run(command, capture_output=True, text=True, timeout=LONG)
    assert result.returncode == 0, result.stderr
    return json.loads(result.stdout.splitlines()[-1])


@pytest.fixture(scope="module")
def few() -> Lights:
    """16 lights of mild colours from all sides, one of them along an axis."""
    rng = np.random.default_rng(5)
    direction = rng.normal(0.3, 1, (16, 3))
    direction[0] = (0, 0, -1)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return Lights(direction.astype(np.float32), rng.uniform(0.5, 1.5, (16, 3)) * rng.uniform(0.5, 1.5, (16, 1)))


SIZE = 63


def meets(image: np.ndarray, device: Device, lights: Lights, tolerance: float) -> None:
    """Assert that the image is ours, except at the rim, where a program may average in the background."""
    ours = shade(device, lights.direction, lights.flux, SIZE)
    centre = (2 * np.arange(SIZE) + 1 - SIZE) / SIZE
    inner = (centre[:, None] ** 2 + centre**2 < (1 - 4 / SIZE) ** 2)[..., None]
    image, ours = image * inner, ours * inner
    assert reference.relative_rmse(image, ours) < tolerance
    for other in (image[::-1], image[:, ::-1], image.swapaxes(0, 1)):
        assert reference.relative_rmse(other, ours) > 10 * tolerance


MITSUBA = """
import sys, json, numpy, mitsuba
mitsuba.set_variant("scalar_rgb")
image = numpy.array(mitsuba.render(mitsuba.load_file(sys.argv[1])))
numpy.save(sys.argv[2], image)
print(json.dumps(mitsuba.__version__))
"""
# The sampler stratifies the number that chooses a light, so all are chosen equally often.
MITSUBA_SCENE = f"""
<scene version="3.0.0">
    <include filename="lights.xml"/>
    <integrator type="direct"><integer name="bsdf_samples" value="0"/></integrator>
    <shape type="sphere">
        <bsdf type="diffuse"><rgb name="reflectance" value="1"/></bsdf>
    </shape>
    <sensor type="orthographic">
        <transform name="to_world"><lookat origin="0, 0, 10" target="0, 0, 0" up="0, 1, 0"/></transform>
        <sampler type="multijitter"><integer name="sample_count" value="256"/></sampler>
        <film type="hdrfilm">
            <integer name="width" value="{SIZE}"/>
            <integer name="height" value="{SIZE}"/>
            <rfilter type="box"/>
            <string name="pixel_format" value="rgb"/>
            <string name="component_format" value="float32"/>
        </film>
    </sensor>
</scene>
"""


@pytest.mark.peer
def test_mitsuba_draws_the_same_sphere(device: Device, few: Lights, tmp_path: Path) -> None:
    write_lights(tmp_path / "lights.xml", few)
    (tmp_path / "scene.xml").write_text(MITSUBA_SCENE)
    ask("mitsuba", MITSUBA, tmp_path / "scene.xml", tmp_path / "image.npy")
    meets(np.load(tmp_path / "image.npy"), device, few, 0.01)


USD = """
import sys, json
from pxr import Gf, Usd, UsdGeom, UsdLux
stage = Usd.Stage.Open(sys.argv[1])
assert UsdGeom.GetStageUpAxis(stage) == "Y"
found = []
for prim in stage.Traverse():
    if prim.IsA(UsdLux.DistantLight):
        light = UsdLux.DistantLight(prim)
        assert light.GetAngleAttr().Get() == 0 and light.GetNormalizeAttr().Get()
        world = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default())
        color, intensity = light.GetColorAttr().Get(), light.GetIntensityAttr().Get()
        found.append([*-world.TransformDir(Gf.Vec3d(0, 0, -1)), *(intensity * c for c in color)])
print(json.dumps(found))
"""


@pytest.mark.peer
def test_usd_opens_the_same_lights(few: Lights, tmp_path: Path) -> None:
    write_lights(tmp_path / "lights.usda", few)
    same(np.array(ask("pxr", USD, tmp_path / "lights.usda")), few, 1e-6)


GLTF = """
import sys, json
from pygltflib import GLTF2
content = GLTF2().load(sys.argv[1])
lights = content.extensions["KHR_lights_punctual"]["lights"]
nodes = [content.nodes[number] for number in content.scenes[content.scene].nodes]
of = [lights[node.extensions["KHR_lights_punctual"]["light"]] for node in nodes]
print(json.dumps([[n.rotation, [light["intensity"] * c for c in light["color"]]] for n, light in zip(nodes, of)]))
"""


@pytest.mark.peer
def test_pygltflib_loads_the_same_lights(few: Lights, tmp_path: Path) -> None:
    write_lights(tmp_path / "lights.gltf", few)
    found = ask("pygltflib", GLTF, tmp_path / "lights.gltf")
    same(np.array([[*turned(w, x, y, z), *flux] for (x, y, z, w), flux in found]), few)


# Runs the script twice: what it adds replaces what it added before.
BLENDER = f"""
import sys, json, math, runpy, bpy
bpy.ops.wm.read_factory_settings(use_empty=True)
for _ in range(2):
    runpy.run_path(sys.argv[1])
bpy.context.view_layer.update()
found = []
for lamp in bpy.data.objects:
    x, y, z = lamp.matrix_world.to_3x3().col[2]
    found.append([x, z, -y, *(lamp.data.energy * c for c in lamp.data.color)])
    assert lamp.data.type == "SUN" and lamp.data.angle == 0
    assert [c.name for c in lamp.users_collection] == ["lightdome lights"]
assert len(bpy.data.lights) == len(found)

bpy.ops.mesh.primitive_uv_sphere_add(segments=256, ring_count=128)
bpy.ops.object.shade_smooth()
white = bpy.data.materials.new("white")
white.use_nodes = True
nodes = white.node_tree.nodes
nodes.clear()
diffuse, output = nodes.new("ShaderNodeBsdfDiffuse"), nodes.new("ShaderNodeOutputMaterial")
diffuse.inputs["Color"].default_value = (1, 1, 1, 1)
white.node_tree.links.new(diffuse.outputs["BSDF"], output.inputs["Surface"])
bpy.context.object.data.materials.append(white)
camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
camera.data.type, camera.data.ortho_scale = "ORTHO", 2
camera.location, camera.rotation_euler = (0, -10, 0), (math.pi / 2, 0, 0)
scene = bpy.context.scene
scene.collection.objects.link(camera)
scene.camera = camera
scene.render.engine = "CYCLES"
scene.render.resolution_x = scene.render.resolution_y = {SIZE}
scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
scene.render.filepath = sys.argv[2]
scene.cycles.samples, scene.cycles.use_adaptive_sampling, scene.cycles.use_denoising = 64, False, False
scene.cycles.max_bounces, scene.cycles.use_light_tree = 0, False
scene.cycles.pixel_filter_type = "BOX"
bpy.ops.render.render(write_still=True)
print()
print(json.dumps(found))
"""


@pytest.mark.peer
def test_blender_has_the_same_lamps_and_draws_the_same_sphere(device: Device, few: Lights, tmp_path: Path) -> None:
    write_lights(tmp_path / "lights.py", few)
    found = np.array(ask("bpy", BLENDER, tmp_path / "lights.py", tmp_path / "image.exr"))
    same(found, few, 1e-6)
    meets(read_image(tmp_path / "image.exr"), device, few, 0.01)
