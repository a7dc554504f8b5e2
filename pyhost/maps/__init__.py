"""An environment map on the host: image files, the map and the geometry of its pixels."""
