"""lightdome: image-based lighting with OpenCL."""

__version__ = "0.1.0"
