"""An environment map on the host: image files, its checked radiance, where its pixels lie, and its projections."""

from .conversion import convert as convert
