"""Another program's images, samples, densities, lights and curves: right or not, and the mistake behind it."""
