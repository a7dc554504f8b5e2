"""Check other programs' images, samples, densities, lights and curves, and name the mistake if one is wrong."""
