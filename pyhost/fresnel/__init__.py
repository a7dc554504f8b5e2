"""Fresnel reflectance of a dielectric: the equations, and their plot."""

from .equations import SchlickError as SchlickError
from .equations import Summary as Summary
from .equations import brewster_angle as brewster_angle
from .equations import critical_angle as critical_angle
from .equations import fresnel as fresnel
from .equations import normal_reflectance as normal_reflectance
from .equations import refraction_angle as refraction_angle
from .equations import schlick as schlick
from .equations import schlick_error as schlick_error
from .equations import summarise as summarise
from .equations import unpolarised as unpolarised
