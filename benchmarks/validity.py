"""How often a solution converges outside the model's assumptions, its rounding, and what looking costs.

Scenes are drawn from a very wide prior: needles of 40 to 400 mm and 0.3 to 2 mm of polymer to steel, one to
five layers of 1 kPa to 100 MPa, t of 5 to 80 mm, alpha of -10 to 10, cuts of 0.001 to 1 mm per mm, constraint
spacings of 0.1 to 2 mm, up to four steps with bases that move, turned bevels and retractions. One in ten
ends with an insertion to within 1e-6 to 0.1 mm of the needle's length.

    python benchmarks/validity.py [--json] [--scenes N] [--seed N]

*Before* counts what has converged with slopes above 1, and above 0.3; *after* counts what of it is still
called valid, which must be nothing. Rounding is what a change of the unit of force by 3 leaves: exact
arithmetic would give the same needle. The cost is that of the validity of a batch over that of its solution.
"""

import argparse
import json
import time
from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
from reference_problem import batch

from needlefit.mechanics.batch import simulate_batches
from needlefit.mechanics.control import Bevel, Controls, ModelOptions, Step
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.shape import LIMITS, compute_validity
from needlefit.mechanics.simulate import simulate_steps
from needlefit.mechanics.tissue import Tissue
from needlefit.schemas.limits import MIN_ELEMENT_MM

UNIT = 3.0
"""Of force; no power of two, by which nothing would round otherwise."""

LONGEST_CELLS = 600
"""Finer spacings are drawn for shorter needles, so that a scene takes milliseconds."""


@dataclass(frozen=True)
class Drawn:
    """A random insertion."""

    needle: Needle
    tissue: Tissue
    steps: tuple[Step, ...]
    rules: ModelOptions


NEARLY_FULL = 0.1
"""Share of the scenes whose deepest step leaves only `STUBS_MM` of the needle before the entry."""
STUBS_MM = (1e-6, 0.1)


def draw(rng: np.random.Generator) -> Drawn:
    """Return a scene of the very wide prior."""

    def log(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    length = log(40, 400)
    needle = Needle.from_tube(length, log(0.3, 2.0), log(2e3, 2.1e5))
    depth, layers = length * rng.uniform(0.05, 0.95), int(rng.integers(1, 6))
    tissue = Tissue(
        np.exp(rng.uniform(np.log(1e-3), np.log(100), layers)),
        rng.uniform(-10, 10, layers),
        np.sort(rng.uniform(0, depth, layers - 1)),
        np.exp(rng.uniform(np.log(5), np.log(80), layers)),
    )
    spacing = max(log(0.1, 2.0), length / LONGEST_CELLS)
    offset = log(1e-3, 1.0) * spacing
    steps = [Step(depth, Bevel(offset, int(rng.choice((1, -1)))))]
    for _ in range(int(rng.integers(0, 4))):
        base = Controls(base_y=rng.normal(0, 5), base_slope=rng.normal(0, 0.05))
        side = int(rng.choice((1, -1)))
        steps.append(Step(length * rng.uniform(0.05, 0.95), Bevel(offset, side), base))
    if rng.random() < NEARLY_FULL:
        steps.append(replace(steps[-1], depth=length - log(*STUBS_MM)))
    parts = int(rng.integers(1, 1 + min(3, int(spacing / MIN_ELEMENT_MM))))
    return Drawn(needle, tissue, tuple(steps), ModelOptions(spacing, spacing / parts))


def in_other_units(scene: Drawn) -> Drawn:
    """Return the same insertion with forces in another unit."""
    needle = replace(scene.needle, flexural_rigidity=UNIT * scene.needle.flexural_rigidity)
    return replace(scene, needle=needle, tissue=replace(scene.tissue, mu=UNIT * scene.tissue.mu))


def shares(scenes: int, seed: int) -> dict[str, object]:
    """Return what became of random scenes."""
    rng, status, faults = np.random.default_rng(seed), Counter[str](), Counter[str]()
    steep, valid, rounding, slowest = [], [], [], 0.0
    for _ in range(scenes):
        scene = draw(rng)
        begin = time.perf_counter()
        shape = simulate_steps(scene.needle, scene.tissue, scene.steps, scene.rules)
        slowest = max(slowest, time.perf_counter() - begin)
        status[shape.status] += 1
        if not shape.converged:
            continue
        found = shape.validity
        steep.append(float(found.max_slope))
        valid.append(shape.valid)
        faults.update(name for name, limit, _ in LIMITS if getattr(found, name) > limit)
        other = in_other_units(scene)
        again = simulate_steps(other.needle, other.tissue, other.steps, other.rules)
        if shape.valid and again.converged:
            error = float(np.abs(again.u - shape.u).max())
            rounding.append(error)
    slopes, kept = np.array(steep), np.array(valid)
    return {
        "scenes": scenes,
        "status": dict(status),
        "before": {
            "slope above 1": float((slopes > 1).sum() / scenes),
            "slope above 0.3": float((slopes > 0.3).sum() / scenes),
            "worst slope": float(slopes.max()),
        },
        "after": {
            "valid": float(kept.sum() / scenes),
            "worst slope of valid": float(slopes[kept].max()),
            "faults": {name: count / scenes for name, count in faults.items()},
        },
        "rounding": {
            "99 % of errors, mm": float(np.quantile(rounding, 0.99)),
            "worst error, mm": float(np.max(rounding)),
        },
        "slowest, s": slowest,
    }


def cost(sets: int = 512, rounds: int = 20) -> dict[str, float]:
    """Return what a batch costs and what its validity costs, microseconds a set, best of some rounds."""
    one = batch(sets, 1e-7)
    (shapes,) = simulate_batches([one], 1)
    solve, look = [], []
    for _ in range(rounds):
        begin = time.perf_counter()
        (shapes,) = simulate_batches([one], 1)
        middle = time.perf_counter()
        compute_validity(shapes).ok.all()
        look.append(time.perf_counter() - middle)
        solve.append(middle - begin)
    best, seen = 1e6 * min(solve) / sets, 1e6 * min(look) / sets
    return {"solve, us": best, "validity, us": seen, "ratio": seen / best}


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--scenes", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    figures = shares(arguments.scenes, arguments.seed) | {"cost": cost()}
    if arguments.json:
        print(json.dumps(figures, indent=2))
        return
    for name, value in figures.items():
        print(f"{name}: {value}")


if __name__ == "__main__":
    main()
