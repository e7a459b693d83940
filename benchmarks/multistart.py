"""How often a default multi-start ends at the best fit, on random problems whose truth is known.

    python benchmarks/multistart.py [--problems 50] [--seeds 20] [--insertions 4] [--larger 10]
                                    [--recipe default] [--starts N] [--jobs 2] [--out FILE] [--json]

Every problem draws a medium of the twin, one to `--insertions` of its insertions, and a truth; the needles
are the model's own at depths that err, displaced and measured with the stated noise. The best known fit is
the best of all seeds, of the recipe with `--larger` times as many starts, of another algorithm (slsqp, as
many starts as the recipe has, without any approach), and of a search begun at the truth. A multi-start has
succeeded if it ends within 0.1 of it in the log posterior. It also reports how many starts
would have been enough: the smallest number of which, drawn at random, 99 % succeed in every problem.

`--out` keeps a line per problem as it is finished; a rerun with the same file goes on after the last one.
"""

import argparse
import json
import math
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from needlefit.datasets.read import read
from needlefit.inference.fit import StartPoint
from needlefit.inference.optimize import minimize, search
from needlefit.inference.problem import Problem, make_posterior_objective, make_problem
from needlefit.project.locate import find_file
from needlefit.project.random_streams import random_stream
from needlefit.project.toml import load
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.recipe import RecipeRecord
from needlefit.studies.simulated_data import simulate_measurement

RANGES = {"mu": (3e4, 1e8), "bevel": (0.02, 0.2)}  # Pa, mm
MEDIA = ("phantom1", "phantom2", "chicken")
EQUAL = 0.1
SURE, NORMAL = 0.99, 1.96


def drawn(number: int, most: int, recipe: RecipeRecord) -> tuple[Problem, np.ndarray]:
    """Return one problem and its true theta; drawn again where the model has no solution at the truth."""
    dataset = read(find_file("dataset", "twin"))
    for attempt in range(100):
        rng = random_stream(number, "multi-start benchmark", str(attempt))
        name = MEDIA[rng.integers(len(MEDIA))]
        medium = load(find_file("medium", name), MediumRecord)
        own = [i for i in dataset.insertions if i.medium == name]
        picked = rng.choice(len(own), size=rng.integers(1, most + 1), replace=False)
        planned = [own[k] for k in sorted(picked)]
        blank = make_problem(dataset, planned, medium, recipe.weights, recipe.likelihood)
        ends = [RANGES["bevel" if n.startswith("bevel") else "mu"] for n in blank.names]
        truth = np.array([rng.uniform(*np.log(pair)) for pair in ends])
        if all(shape.converged for shape in blank.shapes(truth)):
            made = [simulate_measurement(dataset, i, blank.values(truth), medium, rng) for i in planned]
            return make_problem(dataset, made, medium, recipe.weights, recipe.likelihood), truth
    raise RuntimeError(f"problem {number} could not be drawn")


def one(number: int, seeds: int, most: int, larger: int, recipe: RecipeRecord) -> dict[str, object]:
    """Return what every seed of one problem came to, and what else was found."""
    task, truth = drawn(number, most, recipe)
    fits = [minimize(task, recipe, random_stream(seed, "multi-start", str(number))) for seed in range(seeds)]
    many = recipe.model_copy(update={"starts": larger * recipe.starts})
    other = recipe.model_copy(update={"algorithm": "slsqp", "approach": False})
    other_fits = {
        "larger": minimize(task, many, random_stream(seeds, "larger", str(number))).objective,
        "slsqp": minimize(task, other, random_stream(seeds, "other", str(number))).objective,
        "truth": search(
            make_posterior_objective(task), recipe, StartPoint(0, tuple(truth.tolist()))
        ).objective,
    }
    best = min(*other_fits.values(), *(fit.objective for fit in fits))
    return {
        "problem": number,
        "medium": task.medium.title,
        "insertions": len(task.insertions),
        "above": [fit.objective - best for fit in fits],
        "starts_above": [start.objective - best for fit in fits for start in fit.starts],
        "evaluations": [fit.evaluations for fit in fits],
        "others_above": {name: value - best for name, value in other_fits.items()},
    }


def wilson(hits: int, total: int) -> tuple[float, float]:
    """Return the 95 % Wilson interval of a share."""
    centre = (hits + NORMAL**2 / 2) / (total + NORMAL**2)
    half = NORMAL / (total + NORMAL**2) * math.sqrt(hits * (total - hits) / total + NORMAL**2 / 4)
    return max(0.0, centre - half), min(1.0, centre + half)


def enough(rows: list[dict[str, object]]) -> int:
    """Return the fewest starts that succeed to 99 % on average, at each problem's own share of good ones."""
    good = np.array([np.mean(np.array(row["starts_above"]) <= EQUAL) for row in rows])
    return next((n for n in range(1, 1001) if np.mean((1 - good) ** n) <= 1 - SURE), 1001)


def main() -> None:
    """Run the problems that are missing and print the share of successes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name, default in (("problems", 50), ("seeds", 20), ("insertions", 4), ("larger", 10), ("jobs", 2)):
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--recipe", default="default")
    parser.add_argument("--starts", type=int)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    recipe = load(find_file("recipe", options.recipe), RecipeRecord)
    if options.starts:
        recipe = recipe.model_copy(update={"starts": options.starts})
    kept = options.out.read_text().splitlines() if options.out and options.out.exists() else []
    rows = [json.loads(line) for line in kept if line]
    left = [n for n in range(options.problems) if n not in {row["problem"] for row in rows}]
    work = partial(one, seeds=options.seeds, most=options.insertions, larger=options.larger, recipe=recipe)
    with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn")) as pool:
        for row in pool.map(work, left):
            rows.append(row)
            if options.out:
                with options.out.open("a") as file:
                    file.write(json.dumps(row) + "\n")
    if options.json:
        print(json.dumps(rows, indent=2))
        return
    report(rows, recipe)


def report(rows: list[dict[str, object]], recipe: RecipeRecord) -> None:
    """Print the share, its interval, and every failure."""
    ends = np.array([row["above"] for row in rows])  # (problems, seeds)
    hits, total = int(np.sum(ends <= EQUAL)), ends.size
    low, high = wilson(hits, total)
    starts = np.concatenate([row["starts_above"] for row in rows])
    spent = np.concatenate([row["evaluations"] for row in rows])
    print(f"{recipe.algorithm}, {recipe.starts} starts: {hits} of {total} within {EQUAL} of the best known")
    print(f"  {hits / total:.1%}, 95 % interval {low:.1%} to {high:.1%}")
    print(f"  single starts: {np.mean(starts <= EQUAL):.0%}; enough for {SURE:.0%}: {enough(rows)} starts")
    print(f"  evaluations of a multi-start: median {np.median(spent):.0f}, largest {np.max(spent):.0f}")
    for row, above in zip(rows, ends, strict=True):
        missed = {seed: round(float(a), 2) for seed, a in enumerate(above) if a > EQUAL}
        if missed:
            where = f"problem {row['problem']} ({row['medium']}, {row['insertions']} insertions)"
            print(f"  missed: {where}: above the best by {missed}; rivals {row['others_above']}")


if __name__ == "__main__":
    main()
