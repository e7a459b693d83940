"""Which search finds the best fit with the fewest evaluations, on fits of the twin.

    python benchmarks/search.py [--json] [--fits phantom1 phantom2 chicken] [--starts 12] [--jobs 2]

Each algorithm searches for the peak of the posterior from the same starts with the same budget and tolerance
(those of the default recipe), every start alone; the last row is the recipe's own way, by an easier posterior
first, where starts that meet go on as one. A start has succeeded if it ends within 0.1 of the best log
posterior that either found. What counts is what a success costs on average: evaluations, one with
derivatives counted as `--slope` of those without (2.4: 87 against 36 ms for nine insertions), which does not
depend on the machine, and processor time: an evaluation of the easier posterior costs a fraction of another.
"""

import argparse
import json
import time

from needlefit.datasets.read import read
from needlefit.datasets.select import select_insertions
from needlefit.inference.fit import Callbacks
from needlefit.inference.optimize import minimize
from needlefit.inference.problem import make_problem
from needlefit.project.locate import find_file
from needlefit.project.random_streams import random_stream
from needlefit.project.toml import load
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.recipe import RecipeRecord
from needlefit.schemas.study import FitRecord

SEARCHES = ("leastsquares", "slsqp")
APPROACH = "leastsquares, approach"
SUCCESS = 0.1


def search(fit: str, starts: int, slope: float, jobs: int) -> list[dict[str, object]]:
    """Return one row per algorithm."""
    record = load(find_file("fit", fit), FitRecord)
    recipe = load(find_file("recipe", "default"), RecipeRecord)
    dataset = read(find_file("dataset", record.dataset))
    chosen = select_insertions(dataset, record.tune, record.layer_count_rule)
    task = make_problem(
        dataset,
        chosen,
        load(find_file("medium", record.medium), MediumRecord),
        recipe.weights,
        recipe.likelihood,
    )
    found = {}
    for name in (*SEARCHES, APPROACH):
        how = {"algorithm": name.split(",")[0], "starts": starts, "approach": name == APPROACH}
        rng, begun = random_stream(recipe.seed, "search benchmark", fit), time.process_time()
        result = minimize(task, recipe.model_copy(update=how), rng, Callbacks(jobs=jobs))
        found[name] = result, time.process_time() - begun
    best = min(result.objective for result, _ in found.values())
    rows = []
    for name, (result, seconds) in found.items():
        cost = result.evaluations + (slope - 1) * result.gradients
        successes = sum(start.objective < best + SUCCESS for start in result.starts)
        rows.append(
            {
                "fit": fit,
                "algorithm": name,
                "above_best": result.objective - best,
                "successes": successes,
                "starts": starts,
                "evaluations": result.evaluations,
                "gradients": result.gradients,
                "cost_per_success": cost / successes if successes else None,
                "seconds_per_success": seconds / successes if successes else None,
            }
        )
    return rows


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--fits", nargs="+", default=["phantom1", "phantom2", "chicken"])
    parser.add_argument("--starts", type=int, default=12)
    parser.add_argument("--slope", type=float, default=2.4)
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    rows = [row for fit in options.fits for row in search(fit, options.starts, options.slope, options.jobs)]
    if options.json:
        print(json.dumps(rows, indent=2))
        return
    print(f"{'fit':10s} {'algorithm':22s} {'above best':>13s} {'successes':>9s} {'each':>6s} {'s':>6s}")
    for row in rows:
        each = [row[f"{what}_per_success"] for what in ("cost", "seconds")]
        print(
            f"{row['fit']:10s} {row['algorithm']:22s} {row['above_best']:13.5f} "
            f"{row['successes']:4d} / {row['starts']:2d} "
            + ("  none" if None in each else f"{each[0]:6.0f} {each[1]:6.2f}")
        )


if __name__ == "__main__":
    main()
