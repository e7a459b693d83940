"""How often the 95 % interval of each likelihood contains the truth, where the fitted model is the true one.

    python benchmarks/coverage_rates.py [--json] [--problems 40] [--insertions 5] [--seed 1] [--jobs 2]

Every problem draws the moduli and b, simulates needles through the four layers of phantom 2 with the model
itself at depths that err as stated (boundaries as the twin states them, insertion depth by 0.1 mm), moves
them by a pose drawn from its prior and adds the noise of their points. Each likelihood is then
maximised from the truth, and its interval taken from the curvature there (Laplace). Counted are the
combination of moduli and b that such a design determines best (the first direction of its Fisher
information), and b alone.
"""

import argparse
import json
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

sys.path.append(str(Path(__file__).resolve().parents[1] / "studies"))

from research.simulated_data import simulate_measurement

from needlefit.datasets.read import read
from needlefit.inference.parameters import Parameters, with_hyperparameters
from needlefit.inference.problem import Problem
from needlefit.project.locate import find_file
from needlefit.project.toml import load
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.recipe import LikelihoodRecord, WeightsRecord

HOW = {
    "independent, depths fixed": LikelihoodRecord(noise="independent", depths="fixed", bevel_spread=0),
    "independent, depths linear": LikelihoodRecord(noise="independent", depths="linear", bevel_spread=0),
    "correlated, depths fixed": LikelihoodRecord(noise="correlated", depths="fixed", bevel_spread=0),
    "correlated, depths linear": LikelihoodRecord(noise="correlated", depths="linear", bevel_spread=0),
}
RANGES = {"mu1_pa": (1e5, 1e6), "mu2_pa": (3e6, 5e7), "bevel_mm": (0.05, 0.15)}
TIE_SPREAD = 1.2  # as the tissue model states
DEPTH_SD = 0.1  # mm
NORMAL = 1.96


def _make_problem(dataset, insertions, medium, how: LikelihoodRecord) -> Problem:
    parameters = with_hyperparameters(Parameters.from_record(medium), how)
    return Problem(dataset, tuple(insertions), medium, parameters, WeightsRecord(), likelihood=how)


def laplace(task: Problem, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the mode (P,) found from the truth, and the curvature (P, P) of the log posterior there."""

    def down(theta: np.ndarray) -> tuple[float, np.ndarray]:
        value, (residuals, slopes) = task.log_posterior(theta), task.jacobian(theta)
        return (-value, residuals @ slopes) if np.isfinite(value) else (1e12, np.zeros(len(theta)))

    bounds = list(zip(task.lower, task.upper, strict=True))
    mode = minimize(down, truth, jac=True, method="L-BFGS-B", bounds=bounds, options={"ftol": 1e-12}).x
    step = 2e-3
    rows = [(down(mode + step * e)[1] - down(mode - step * e)[1]) / (2 * step) for e in np.eye(len(mode))]
    return mode, 0.5 * (np.array(rows) + np.array(rows).T)


def one(number: int, insertions: int, seed: int) -> list[dict[str, object]]:
    """Return one row per likelihood of one problem."""
    rng = np.random.default_rng([seed, number])
    dataset = read(find_file("dataset", "twin"))
    medium = load(find_file("medium", "phantom2"), MediumRecord)
    values = {name: float(np.exp(rng.uniform(*np.log(ends)))) for name, ends in RANGES.items()}
    for layer in (3, 4):  # tied to layers 1 and 2, within a factor
        values[f"mu{layer}_pa"] = values[f"mu{layer - 2}_pa"] * np.exp(rng.normal(0, np.log(TIE_SPREAD)))
    into = [i for i in dataset.insertions if i.medium == "phantom2"][:insertions]
    planned = [replace(i, depth_sd=DEPTH_SD) for i in into]
    start = _make_problem(dataset, planned, medium, LikelihoodRecord(bevel_spread=0))
    truth = start.parameters.theta(values)
    everything = start.values(truth)
    made = [
        i for one in planned if (i := simulate_measurement(dataset, one, everything, medium, rng)) is not None
    ]
    tasks = {name: _make_problem(dataset, made, medium, how) for name, how in HOW.items()}
    slope = tasks["correlated, depths linear"].jacobian(truth)[1]
    stiff = np.linalg.eigh(slope.T @ slope)[1][:, -1]
    bevel = np.eye(len(truth))[-1]
    rows = []
    for name, task in tasks.items():
        mode, curvature = laplace(task, truth)
        found = bool(np.all(np.linalg.eigvalsh(curvature) > 0))
        for of, direction in (("stiffest", stiff), ("b", bevel)):
            variance = max(0.0, float(direction @ np.linalg.solve(curvature, direction)))
            row = {"error": float(direction @ (mode - truth)), "sd": variance**0.5, "found": found}
            rows.append({"likelihood": name, "of": of, **row})
    return rows


def summary(rows: list[dict[str, object]]) -> dict[str, object]:
    """Return how often the intervals cover the truth, and how wide they are."""
    errors, sds = (np.array([row[key] for row in rows], dtype=float) for key in ("error", "sd"))
    return {
        "likelihood": rows[0]["likelihood"],
        "of": rows[0]["of"],
        "covered": int(np.sum(np.abs(errors) <= NORMAL * sds)),
        "problems": len(rows),
        "error_rms": float(np.sqrt(np.mean(errors**2))),
        "sd_median": float(np.median(sds)),
        "no_mode": sum(not row["found"] for row in rows),
    }


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--problems", type=int, default=40)
    parser.add_argument("--insertions", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    work = partial(one, insertions=options.insertions, seed=options.seed)
    with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn")) as pool:
        rows = [row for some in pool.map(work, range(options.problems)) for row in some]
    kinds = dict.fromkeys((row["likelihood"], row["of"]) for row in rows)
    found = [summary([row for row in rows if (row["likelihood"], row["of"]) == kind]) for kind in kinds]
    if options.json:
        print(json.dumps(found, indent=2))
        return
    for row in found:
        print(
            f"{row['likelihood']:34s} {row['of']:9s} covered {row['covered']:3d} of {row['problems']}   "
            f"rms error {row['error_rms']:.4f}   median deviation {row['sd_median']:.4f}   "
            f"no mode {row['no_mode']}"
        )


if __name__ == "__main__":
    main()
