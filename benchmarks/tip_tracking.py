"""What a tracked tip tells ahead: the tip 20 mm deeper, with and without updates of moduli and b.

    python benchmarks/tip_tracking.py [--needles 200] [--ahead 20] [--json]

Synthetic needles in phantom 2: moduli and b are drawn from the prior, about the values of the scene. The tip
is read once a millimetre with errors of 0.5 mm across and along the needle, by a tracker whose registration
is off by 0.5 mm and 0.01 (standard deviations). At each depth the tip 20 mm deeper is predicted from the
prior alone, and from the estimate of all readings so far; the interval is that of 200 draws. `path angle`:
the needle advances by another rule than the estimate knows, with a cut angle by which the scene's needle has
the same tip at 60 mm.
"""

import argparse
import json
from dataclasses import replace
from functools import cache
from time import perf_counter

import numpy as np
from scipy.optimize import brentq

from needlefit.inference.tracking import (
    TipNoise,
    TrackedNeedle,
    estimate_parameters,
    make_prior_from_factors,
)
from needlefit.mechanics.batch import Batch, simulate_batches
from needlefit.mechanics.plan import Lattice
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.simulate import simulate_steps
from needlefit.viewer.opening import open_target

NOISE = TipNoise(across=0.5, along=0.5, shift=0.5, slope=0.01)
DEPTHS, DRAWS = (20.0, 40.0, 60.0, 80.0), 200
EQUAL_AT_MM = 60.0
CASES = {
    "new specimen (factors 2.0, 1.8)": (2.0, 1.8, False),
    "same specimen (factors 1.2, 1.2)": (1.2, 1.2, False),
    "path angle (factors 2.0, 1.8)": (2.0, 1.8, True),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--needles", type=int, default=200)
    parser.add_argument("--ahead", type=float, default=20.0)
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    rows = [row for name, case in CASES.items() for row in measure(name, *case, asked.needles, asked.ahead)]
    if asked.json:
        print(json.dumps(rows, indent=2))
        return
    for row in rows:
        print("  ".join(f"{key} {value}" for key, value in row.items()))


def measure(name, modulus, bevel, other_rule, needles, ahead):
    """Return a row for each depth: RMS errors without and with updates, coverage, time of an update."""
    scene = Scene.from_record(open_target("phantom2").record, "phantom2")
    step, rng = scene.steps[0], np.random.default_rng(7)
    prior = make_prior_from_factors(scene.tissue.mu, step.bevel.offset, (modulus, bevel), NOISE)
    errors = {depth: [] for depth in DEPTHS}
    for _ in range(needles):
        truth = prior.transform(rng.standard_normal((1, len(prior.theta))))[0]
        passed, track = simulate_truth(scene, truth, other_rule, max(DEPTHS) + ahead)
        at = np.arange(1.0, max(DEPTHS) + 1)
        true_tip = np.interp(at + rng.normal(0, NOISE.along, len(at)), passed, track)
        noise = rng.normal(0, NOISE.across, len(at)) + rng.normal(0, NOISE.shift)
        readings = np.column_stack([at, true_tip + noise + rng.normal(0, NOISE.slope) * at])
        start = None
        for depth in DEPTHS:
            inserted = TrackedNeedle(
                scene.needle, scene.tissue, (replace(step, depth=depth),), scene.rules, 1.0
            )
            began = perf_counter()
            found = estimate_parameters(inserted, readings[at <= depth], prior, NOISE, start)
            spent = perf_counter() - began
            if found is None:
                continue
            start = found
            whole = inserted._replace(steps=(replace(step, depth=depth + ahead),))
            true = np.interp(depth + ahead, passed, track)
            tips = [predict(whole, one, rng) for one in (prior, found)]
            errors[depth].append([*[(tip - true, low <= true <= high) for tip, low, high in tips], spent])
    for depth, found in errors.items():
        off = np.array([[one[0][0], one[1][0]] for one in found])
        covered = np.mean([[one[0][1], one[1][1]] for one in found], axis=0)
        rms, median = np.sqrt(np.mean(off**2, axis=0)), np.median(np.abs(off), axis=0)
        yield {
            "case": name,
            "depth_mm": depth,
            "needles": len(found),
            "rms_without_mm": round(rms[0], 2),
            "rms_with_mm": round(rms[1], 2),
            "median_without_mm": round(median[0], 2),
            "median_with_mm": round(median[1], 2),
            "covered_without": round(covered[0], 3),
            "covered_with": round(covered[1], 3),
            "update_ms": round(1e3 * float(np.median([one[2] for one in found])), 1),
        }


def simulate_truth(scene, truth, other_rule, depth):
    """Return depth and deflection of the tip on its way."""
    rules, bevel = scene.rules, replace(scene.steps[0].bevel, offset=float(truth[-1]))
    if other_rule:
        rules = replace(rules, advance="path_angle")
        strength = truth[-1] / scene.steps[0].bevel.offset
        bevel = replace(bevel, offset=0.0, cut_angle=strength * find_equal_angle())
    tissue, step = replace(scene.tissue, mu=truth[:-1]), scene.steps[0]
    lattice = Lattice(1.0, rules.spacing)
    shape = simulate_steps(scene.needle, tissue, (replace(step, depth=depth, bevel=bevel),), rules, lattice)
    return shape.constraints[:, 0], shape.tip_track[:, 0]


@cache
def find_equal_angle() -> float:
    """Return the cut angle, rad, by which the scene's own needle has the same tip at `EQUAL_AT_MM`."""
    scene = Scene.from_record(open_target("phantom2").record, "phantom2")
    step = replace(scene.steps[0], depth=EQUAL_AT_MM)
    wanted = simulate_steps(scene.needle, scene.tissue, (step,), scene.rules).tip_lateral
    rules = replace(scene.rules, advance="path_angle")

    def excess(angle: float) -> float:
        cut = replace(step, bevel=replace(step.bevel, offset=0.0, cut_angle=angle))
        return simulate_steps(scene.needle, scene.tissue, (cut,), rules).tip_lateral - wanted

    return brentq(excess, 1e-4, 0.3)


def predict(whole: TrackedNeedle, estimate, rng):
    """Return the tip at the end with the estimate's mean, and the 95 % interval of draws."""
    drawn = estimate.transform(rng.standard_normal((DRAWS, len(estimate.theta))))
    drawn = np.vstack([np.exp(estimate.theta), drawn])
    rules = replace(whole.rules, first_cell=whole.first_cell)
    batch = Batch(whole.needle, whole.tissue, whole.steps, rules, mu=drawn[:, :-1], offset=drawn[:, -1])
    (shapes,) = simulate_batches([batch], threads=1)
    tips = shapes.tip_track[:, -1, 0]
    low, high = np.percentile(tips[shapes.converged], [2.5, 97.5])
    return tips[0], low, high


if __name__ == "__main__":
    main()
