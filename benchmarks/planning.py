"""How long a plan takes, and whether its probability is right.

    python benchmarks/planning.py [--targets 12] [--seed 1] [--json]

Plans for random targets of radius 0.3 mm in phantom 2 with 132 draws of its parameters (b to 20 %, moduli to
a factor of 1.5), on one core. `probability` is the mean that the plans print, `share` that of 400 further
draws that hit.
"""

import argparse
import json
import time
from dataclasses import replace

import numpy as np

from needlefit.inference.forward_model import ParameterDraws
from needlefit.mechanics.batch import compute_batch_positions
from needlefit.planning.goals import Goal, find_hits
from needlefit.planning.steering import StartedInsertion, find_reachable_region, plan_steering
from needlefit.viewer.opening import open_target
from needlefit.viewer.plans import begin_insertion


def draw_parameters(insertion: StartedInsertion, count: int, rng: np.random.Generator) -> ParameterDraws:
    """Return draws about the insertion's own parameters."""
    exact = insertion.exact
    mu = exact.mu * np.exp(np.log(1.5) * rng.standard_normal((count, exact.mu.shape[1])))
    bevel = exact.bevel * np.exp(0.2 * rng.standard_normal(count))
    return ParameterDraws(mu, np.repeat(exact.shape, count, 0), bevel)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--targets", type=int, default=12)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    rng = np.random.default_rng(asked.seed)
    start = begin_insertion(open_target("phantom2"))
    insertion = replace(start, draws=draw_parameters(start, 132, rng))
    further = replace(start, draws=draw_parameters(start, 400, rng))
    began = time.perf_counter()
    find_reachable_region(insertion, 50.0, threads=1)
    region_s = time.perf_counter() - began
    spent, stated, found = [], [], []
    for x, y in rng.uniform((30, -3), (55, 3), (asked.targets, 2)).tolist():
        goal, began = Goal((x, y), 0.3), time.perf_counter()
        plan = plan_steering(insertion, goal, threads=1)
        spent.append(time.perf_counter() - began)
        stated.append(plan.probability)
        (shapes,) = further.simulate(further.draws, [plan.steps], None)
        tips = compute_batch_positions(shapes, np.array([0.0, plan.end.depth]))
        found.append(float(np.mean(find_hits(tips, goal))))
    result = {
        "plan_s": {"median": round(float(np.median(spent)), 2), "greatest": round(max(spent), 2)},
        "reachable_region_s": round(region_s, 3),
        "probability": round(float(np.mean(stated)), 3),
        "share": round(float(np.mean(found)), 3),
    }
    if asked.json:
        print(json.dumps(result, indent=2))
        return
    for key, value in result.items():
        print(f"{key:20} {value}")


if __name__ == "__main__":
    main()
