"""The same sphere rendered by PBRT: scenes, equal-area maps, running the program, and checking its image."""

from .run import PORTS as PORTS
from .run import Pbrt as Pbrt
from .run import decisions as decisions
from .run import find_pbrt as find_pbrt
from .run import installed_port as installed_port
from .run import render as render
from .run import render_scene as render_scene
from .scenes import Scene as Scene
from .scenes import scene_text as scene_text
from .scenes import write_scenes as write_scenes
