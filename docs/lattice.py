#!/usr/bin/env python3
"""Find LATTICE_GENERATOR of clkernels/rendering/pixel_block.clh, and compare it with generators for a single n.

Up to a factor, P2 is the squared error of the worst periodic function whose Fourier coefficients fall as 1 / (h k)^2
(Sloan and Joe, Lattice Methods for Multiple Integration, 1994, 4.4). A point set for pixels has to be good at every
power of two, so the search keeps the generators with the smallest maximum of n^2 P2 / log2(n) over n = 8 .. 2^20.
"""

import numpy as np
from lightdome.sampling.lattice import generator

SMALLEST, LARGEST = 3, 20  # log2 of the numbers of points
KEPT = 64  # generators, from one number of points to the next; fewer if the points are many, which takes long
KEPT_LARGE = 8


def p2(n: int, g: int) -> float:
    """P2 of the lattice (i, g i) / n, the sum of 1 / (h k)^2 over its dual, with 1 in place of 0."""
    i = np.arange(n)
    x = i / n
    kernel = 1 + 2 * np.pi**2 * (x * x - x + 1 / 6)
    return float(kernel @ kernel[i * g % n] / n - 1)


def scaled_p2(k: int, g: int) -> float:
    """n^2 P2 / log2(n) for n = 2^k, which is nearly constant for the best generators."""
    return p2(2**k, g) * 4**k / k


def search() -> np.ndarray:
    """The best generators. g, -g, 1 / g and -1 / g only mirror or swap the axes, and are equally good."""
    found, worst = np.array([1]), np.zeros(1)
    for k in range(2, LARGEST + 1):  # g modulo 2^k is g or g + 2^(k - 1) modulo 2^(k - 1)
        found, worst = np.concatenate([found, found + 2 ** (k - 1)]), np.tile(worst, 2)
        if k >= SMALLEST:
            worst = np.maximum(worst, [scaled_p2(k, g) for g in found.tolist()])
            best = np.argsort(worst.round(6), kind="stable")[: KEPT if k <= 13 else KEPT_LARGE]
            found, worst = found[best], worst[best]
    return found[worst.round(6) == worst[0].round(6)]


def main() -> None:
    # Of those that are equally good, the one with the smallest error of `light` and `mis` on Grace at 64 spp.
    equals = search()
    print("equally good:", *equals)
    chosen = int(equals[equals % 64 == 19][0])
    print("            n    one for all n    one for this n: n^2 P2 / log2(n)")
    for k in range(SMALLEST, LARGEST + 1):
        n = 2**k
        row = [scaled_p2(k, g) for g in (chosen % n, generator(n))]
        print(f"{n:13,}" + "".join(f"{value:17.1f}" for value in row))


if __name__ == "__main__":
    main()
