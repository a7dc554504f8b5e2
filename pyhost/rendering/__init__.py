"""From a distribution to an image of the sphere, with fresh samples for every pixel."""

from .per_pixel import render as render
