"""How often the 95 % of `needlefit material` hold the truth: alpha of a specimen, and of a further one.

    python benchmarks/material.py [--curves N]

Curves of 60 points (200 where errors are correlated by 0.98) to a stretch of 0.75, alpha 2, with errors of
1 % of the largest stress, correlated from point to point. Then tests of 3 and 5 specimens to 0.8,
their alphas scattered by 0.6 about -5, errors of 0.5 % correlated by 0.9; those that identify fewer than two
alphas are left out.
"""

import argparse
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.compression import CompressionTest, SpecimenLoading
from needlefit.inference.material import NORMAL_95_HALF_WIDTH_SD, fit_material, fit_specimen
from needlefit.mechanics.compression import compute_stress

Floats = NDArray[np.float64]


def curve(alpha: float, low: float, error: Floats) -> SpecimenLoading:
    """Return a loading to `low` with the errors (N,), parts of its largest stress."""
    stretch = np.linspace(1.0, low, len(error))
    exact = compute_stress(0.01, alpha, stretch, "nominal")
    return SpecimenLoading("gel", stretch, exact + error * np.max(np.abs(exact)))


def correlated(count: int, neighbours: float, sd: float, rng: np.random.Generator) -> Floats:
    """Return errors (N,) of which neighbours are correlated."""
    fresh = rng.normal(size=count)
    found = [fresh[0]]
    for one in fresh[1:]:
        found.append(neighbours * found[-1] + math.sqrt(1 - neighbours**2) * one)
    return sd * np.array(found)


def of_a_specimen(points: int, neighbours: float, curves: int, rng: np.random.Generator) -> float:
    """Return the part of curves whose region holds the true alpha."""
    held = 0
    for _ in range(curves):
        fit = fit_specimen(curve(2.0, 0.75, correlated(points, neighbours, 0.01, rng)), "nominal")
        held += any(low <= 2.0 <= high for low, high in fit.profile.regions)
    return held / curves


def of_a_further_one(specimens: int, tests: int, rng: np.random.Generator) -> tuple[int, int]:
    """Return in how many tests the 95 % hold a further alpha, and of how many that is."""
    held = known = 0
    for _ in range(tests):
        alphas = -5 + 0.6 * rng.normal(size=specimens + 1)
        made = tuple(curve(a, 0.8, correlated(60, 0.9, 0.005, rng)) for a in alphas[:-1])
        found = fit_material(CompressionTest(Path(), "", "nominal", (), made, ()))
        if len(found.pooled) > 1:
            known += 1
            held += abs(alphas[-1] - found.mean[1]) < NORMAL_95_HALF_WIDTH_SD * found.sds[1]
    return held, known


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--curves", type=int, default=200)
    curves = parser.parse_args().curves
    rng = np.random.default_rng(1)
    for points, neighbours in ((60, 0.0), (60, 0.8), (60, 0.9), (60, 0.95), (200, 0.98)):
        part = of_a_specimen(points, neighbours, curves, rng)
        print(f"{points:4d} points, errors correlated by {neighbours:4.2f}: {100 * part:5.1f} % of {curves}")
    for specimens in (3, 5):
        held, known = of_a_further_one(specimens, curves // 2, rng)
        print(f"a further specimen after {specimens}: {held} of {known} tests")


if __name__ == "__main__":
    main()
