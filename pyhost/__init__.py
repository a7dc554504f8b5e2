"""lightdome: image-based lighting with OpenCL.

    import lightdome

    device = lightdome.open_device()
    envmap = lightdome.EnvironmentMap.read("map.exr")
    distribution = lightdome.build_distribution(device, envmap)
    samples = distribution.sample(1024, seed=1)
    image = lightdome.shade_samples(device, samples, resolution=511)
    lightdome.write_image("sphere.pfm", image)

Data flows one way: a map (:mod:`.envmap`) becomes a distribution (:mod:`.distribution`), that becomes
samples (:mod:`.samples`), and those light a sphere (:mod:`.sphere`). :mod:`.banded` draws samples of a map that is
larger than the memory. :mod:`.render` draws the same
sphere per pixel, :mod:`.pbrt` lets PBRT draw it, :mod:`.mediancut` and :mod:`.harmonics` light it without
chance, :mod:`.lights` writes light sets for other programs, :mod:`.fresnel` stands alone, and
:mod:`.reference` holds what all of it is checked against.
"""

from __future__ import annotations

from importlib import import_module

__version__ = "0.1.0"
TYPE_CHECKING = False  # as typing has it, which takes long to load

if TYPE_CHECKING:
    from . import (  # noqa: F401
        banded,
        benchmark,
        benchmark_plot,
        buffers,
        cache,
        checks,
        cli,
        decisions,
        device,
        disc,
        distribution,
        envmap,
        equiarea,
        errors,
        exr,
        exr_layers,
        files,
        float_range,
        fresnel,
        fresnel_plot,
        guide,
        harmonics,
        horizon,
        image_source,
        images,
        interrupts,
        lights,
        markers,
        mediancut,
        names,
        oiio_files,
        pbrt,
        pbrt_check,
        peer_mitsuba,
        peer_mitsuba_distribution,
        peer_numpy,
        peer_pbrt,
        peers,
        pfm,
        plotting,
        probe,
        product,
        profile,
        programs,
        progress,
        radiance_hdr,
        rates,
        reference,
        render,
        report,
        report_figures,
        roofline,
        roofline_plot,
        roofline_stages,
        samples,
        settings,
        sphere,
        stability,
        stability_cases,
        stability_plot,
    )
    from .banded import sample_file
    from .device import Device, open_device
    from .distribution import Distribution, build_distribution
    from .envmap import EnvironmentMap
    from .errors import LightdomeError
    from .harmonics import Harmonics, project, shade_harmonics
    from .images import ImageRows, auto_exposure, read_image, tone_map, write_image
    from .lights import Lights, write_csv, write_pbrt
    from .mediancut import median_cut
    from .samples import Samples
    from .sphere import exact, shade, shade_samples

# Loaded when first used, as every module is: Fresnel needs no OpenCL, shading no image library.
_HOME = {
    "Device": "device",
    "open_device": "device",
    "Distribution": "distribution",
    "build_distribution": "distribution",
    "EnvironmentMap": "envmap",
    "LightdomeError": "errors",
    "Harmonics": "harmonics",
    "project": "harmonics",
    "shade_harmonics": "harmonics",
    "ImageRows": "images",
    "auto_exposure": "images",
    "read_image": "images",
    "tone_map": "images",
    "write_image": "images",
    "Lights": "lights",
    "write_csv": "lights",
    "write_pbrt": "lights",
    "median_cut": "mediancut",
    "Samples": "samples",
    "sample_file": "banded",
    "exact": "sphere",
    "shade": "sphere",
    "shade_samples": "sphere",
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
    "exact",
    "median_cut",
    "open_device",
    "project",
    "read_image",
    "sample_file",
    "shade",
    "shade_harmonics",
    "shade_samples",
    "tone_map",
    "write_csv",
    "write_image",
    "write_pbrt",
]


if not TYPE_CHECKING:  # or a type checker would take it for the type of every name, wrong ones too

    def __getattr__(name: str) -> object:
        if name in _HOME:
            return getattr(import_module(f".{_HOME[name]}", __name__), name)
        if not name.startswith("_"):
            try:
                return import_module(f".{name}", __name__)
            except ModuleNotFoundError as error:
                if error.name != f"{__name__}.{name}":  # it is there, and something else is missing
                    raise
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    from pkgutil import iter_modules

    return sorted({*__all__, *(module.name for module in iter_modules(__path__))})
