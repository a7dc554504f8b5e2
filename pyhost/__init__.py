"""lightdome: image-based lighting with OpenCL.

    import lightdome

    device = lightdome.open_device()
    envmap = lightdome.EnvironmentMap.read(lightdome.default_map())  # or your own file
    distribution = lightdome.build_distribution(device, envmap)
    samples = distribution.sample(1024, seed=1)
    image = lightdome.shade_samples(device, samples, resolution=511)
    lightdome.write_image("sphere.pfm", image)

Data flows one way, and the folders follow it: :mod:`lightdome.maps` reads a map; :mod:`lightdome.sampling` turns it
into a distribution and draws samples; :mod:`lightdome.lighting` lights a sphere with the samples or with the whole map;
:mod:`lightdome.rendering` renders the same sphere with fresh samples for every pixel. :mod:`lightdome.pbrt` has PBRT
render it; :mod:`lightdome.fresnel` stands alone; :mod:`lightdome.evaluation` measures the error of each method;
:mod:`lightdome.checking` tells whether another program's results are right; :mod:`lightdome.viewer` shows all of it in
a browser; :mod:`lightdome.reference` holds the references that everything is checked against.
"""

from __future__ import annotations

from importlib import import_module

__version__ = "0.2.0"
TYPE_CHECKING = False  # as in typing, which is slow to import

if TYPE_CHECKING:
    from . import (  # noqa: F401
        cache,
        checking,
        checks,
        commands,
        console,
        decisions,
        disc,
        errors,
        evaluation,
        files,
        float_range,
        fresnel,
        interrupts,
        lighting,
        maps,
        names,
        opencl,
        pbrt,
        plotting,
        probe,
        progress,
        reference,
        rendering,
        sampling,
        viewer,
    )
    from .checking.fresnel import check_fresnel
    from .checking.image import check_image
    from .checking.lights import check_lights
    from .checking.pdf import check_pdf
    from .checking.samples import check_samples
    from .errors import LightdomeError
    from .lighting.exact import exact
    from .lighting.harmonics import Harmonics, project, shade_harmonics
    from .lighting.light_files import write_csv, write_lights, write_pbrt
    from .lighting.lights import Lights
    from .lighting.median_cut import median_cut
    from .lighting.shade import shade, shade_samples
    from .maps.default_map import default_map
    from .maps.envmap import EnvironmentMap
    from .maps.images import ImageRows, auto_exposure, read_image, tone_map, write_image
    from .maps.pictures import show
    from .opencl.device import Device, open_device
    from .sampling.distribution import Distribution, build_distribution
    from .sampling.samples import Samples
    from .sampling.streaming import sample_file
    from .viewer.notebook import view

# Loaded on first use, like every module: Fresnel needs no OpenCL, and shading needs no image library.
_HOME = {
    "Device": "opencl.device",
    "open_device": "opencl.device",
    "Distribution": "sampling.distribution",
    "build_distribution": "sampling.distribution",
    "EnvironmentMap": "maps.envmap",
    "default_map": "maps.default_map",
    "LightdomeError": "errors",
    "check_fresnel": "checking.fresnel",
    "check_image": "checking.image",
    "check_lights": "checking.lights",
    "check_pdf": "checking.pdf",
    "check_samples": "checking.samples",
    "Harmonics": "lighting.harmonics",
    "project": "lighting.harmonics",
    "shade_harmonics": "lighting.harmonics",
    "ImageRows": "maps.images",
    "auto_exposure": "maps.images",
    "read_image": "maps.images",
    "tone_map": "maps.images",
    "write_image": "maps.images",
    "show": "maps.pictures",
    "Lights": "lighting.lights",
    "write_csv": "lighting.light_files",
    "write_lights": "lighting.light_files",
    "write_pbrt": "lighting.light_files",
    "median_cut": "lighting.median_cut",
    "Samples": "sampling.samples",
    "sample_file": "sampling.streaming",
    "exact": "lighting.exact",
    "shade": "lighting.shade",
    "shade_samples": "lighting.shade",
    "view": "viewer.notebook",
}

__all__ = [
    "Device",
    "Distribution",
    "EnvironmentMap",
    "Harmonics",
    "ImageRows",
    "LightdomeError",
    "Lights",
    "Samples",
    "__version__",
    "auto_exposure",
    "build_distribution",
    "check_fresnel",
    "check_image",
    "check_lights",
    "check_pdf",
    "check_samples",
    "default_map",
    "exact",
    "median_cut",
    "open_device",
    "project",
    "read_image",
    "sample_file",
    "shade",
    "shade_harmonics",
    "shade_samples",
    "show",
    "tone_map",
    "view",
    "write_csv",
    "write_image",
    "write_lights",
    "write_pbrt",
]


if not TYPE_CHECKING:  # hidden from type checkers, which would then accept any name

    def __getattr__(name: str) -> object:
        if name in _HOME:
            return getattr(import_module(f".{_HOME[name]}", __name__), name)
        if not name.startswith("_"):
            try:
                return import_module(f".{name}", __name__)
            except ModuleNotFoundError as error:
                if error.name != f"{__name__}.{name}":  # the module exists, but one of its imports is missing
                    raise
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    from pkgutil import iter_modules

    names = (module.name for module in iter_modules(__path__))
    return sorted({*__all__, *(name for name in names if not name.startswith("_"))})
