"""From a distribution to an image of the sphere, with fresh samples for every pixel."""

from .estimate import ErrorEstimate as ErrorEstimate
from .estimate import estimate_error as estimate_error
from .per_pixel import render as render
from .to_error import Rendered as Rendered
from .to_error import render_to_error as render_to_error
