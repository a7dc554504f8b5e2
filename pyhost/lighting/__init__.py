"""From lights, or from a whole map, to an image of the sphere."""
