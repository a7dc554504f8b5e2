"""Render views of a map with another program: run by a Python that has the program, and numpy.

    python convention_views.py PROGRAM MAP.exr VIEWS.npy IMAGES.npy

``VIEWS.npy`` is (N, 2, 3): the forward and up vectors of each view, in the program's own axes. ``IMAGES.npy`` becomes
(N, S, S, 3), linear, row 0 at the top, from perspective cameras with an angle of view of :data:`ANGLE` across and down.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

SIZE = 96  # pixels across and down
ANGLE = 120.0  # degrees


def mitsuba(path: Path, views: np.ndarray) -> np.ndarray:
    """Mitsuba 3: ``envmap`` and ``perspective``."""
    import mitsuba

    mitsuba.set_variant("scalar_rgb")
    images = []
    for forward, up in views.tolist():
        scene = {
            "type": "scene",
            "integrator": {"type": "direct"},
            "light": {"type": "envmap", "filename": str(path)},
            "sensor": {
                "type": "perspective",
                "fov": ANGLE,
                "to_world": mitsuba.ScalarTransform4f().look_at(origin=[0, 0, 0], target=forward, up=up),
                "film": {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}},
                "sampler": {"type": "stratified", "sample_count": 4},
            },
        }
        images.append(np.array(mitsuba.render(mitsuba.load_dict(scene)))[..., :3])
    return np.array(images)


def skylibs(path: Path, views: np.ndarray) -> np.ndarray:
    """skylibs: ``EnvironmentMap.interpolate`` at the directions of the camera's pixels."""
    from envmap import EnvironmentMap

    envmap = EnvironmentMap(np.load(path.with_suffix(".npy")).astype(np.float64), "latlong")
    step = np.tan(np.radians(ANGLE / 2)) * (2 * (np.arange(SIZE) + 0.5) / SIZE - 1)
    images = []
    for forward, up in views:
        towards = forward + step[None, :, None] * np.cross(forward, up) - step[:, None, None] * up
        x, y, z = np.moveaxis(towards / np.linalg.norm(towards, axis=-1, keepdims=True), -1, 0)
        u, v = envmap.world2image(x, y, z)
        images.append(envmap.copy().interpolate(u, v).data)
    return np.array(images)


def cycles(path: Path, views: np.ndarray) -> np.ndarray:
    """Blender: a world with an environment texture, and a camera, rendered by Cycles on the CPU."""
    import bpy
    from mathutils import Matrix

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.world = bpy.data.worlds.new("world")
    scene.world.use_nodes = True
    nodes = scene.world.node_tree.nodes
    texture = nodes.new("ShaderNodeTexEnvironment")
    texture.image = bpy.data.images.load(str(path))
    texture.image.colorspace_settings.name = "Non-Color"
    scene.world.node_tree.links.new(texture.outputs["Color"], nodes["Background"].inputs["Color"])

    camera = bpy.data.cameras.new("camera")
    camera.angle = np.radians(ANGLE)
    scene.camera = bpy.data.objects.new("camera", camera)
    scene.collection.objects.link(scene.camera)
    scene.render.engine = "CYCLES"
    scene.cycles.samples = 4
    scene.cycles.use_denoising = False
    scene.render.resolution_x = scene.render.resolution_y = SIZE
    scene.render.image_settings.file_format = "OPEN_EXR"
    images = []
    with tempfile.TemporaryDirectory() as folder:
        for n, (forward, up) in enumerate(views):
            # A camera looks along its -z, with its +y up.
            axes = np.stack([np.cross(forward, up), up, -forward], axis=1)
            scene.camera.matrix_world = Matrix(axes.tolist()).to_4x4()
            scene.render.filepath = f"{folder}/{n}.exr"
            bpy.ops.render.render(write_still=True)
            image = bpy.data.images.load(scene.render.filepath)
            image.colorspace_settings.name = "Non-Color"
            images.append(np.array(image.pixels).reshape(SIZE, SIZE, 4)[::-1, :, :3])  # Blender's rows go bottom up
    return np.array(images)


if __name__ == "__main__":
    program, path, views, images = sys.argv[1:]
    np.save(images, {"mitsuba": mitsuba, "skylibs": skylibs, "cycles": cycles}[program](Path(path), np.load(views)))
