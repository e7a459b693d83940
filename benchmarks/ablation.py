"""Why the fit of study 1 errs in mu1: python benchmarks/ablation.py [--json].

The nine insertions across the four layers of phantom 2, of the synthetic dataset that ships, are fitted with
single assumptions changed: exact ties, errors of layer depths that are independent between insertions, points
in place of cross-sections, and needles without the friction of the truth (its effect by the true model is
taken from the measured points). A row: ratio of the fitted mu1 and b to the truth, standard deviation of ln,
and their quotient z. Deviations are Gauss-Newton; each fit begins from three starts.
"""

import argparse
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pandas as pd
from scipy.optimize import least_squares

from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.datasets.read import read
from needlefit.inference.problem import Problem, make_problem
from needlefit.mechanics.control import Bevel
from needlefit.mechanics.shape import compute_positions
from needlefit.mechanics.simulate import simulate
from needlefit.project.locate import find_file
from needlefit.project.toml import load
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.recipe import LikelihoodRecord, WeightsRecord
from needlefit.synthetic.design import bevel_offset, draw_needle, draw_specimen, list_planned_insertions
from needlefit.synthetic.insertion import TRUTH_OPTIONS, TWIN_SEED, simulate_insertion

MEDIUM = "phantom2"
STARTS = (0.0, -0.7, 0.7)
"""Of the searches, in ln of every parameter from the truth."""
EXACT, INDEPENDENT, POINTS, FRICTIONLESS = "exact ties", "independent boundaries", "points", "no friction"
VARIANTS = (
    (),
    (EXACT,),
    (INDEPENDENT,),
    (POINTS,),
    (POINTS, FRICTIONLESS),
    (EXACT, INDEPENDENT),
    (EXACT, INDEPENDENT, POINTS),
    (EXACT, INDEPENDENT, POINTS, FRICTIONLESS),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true")
    dataset = read(find_file("dataset", "twin"))
    rows = pd.DataFrame([fit_variant(dataset, changed) for changed in VARIANTS])
    print(rows.to_json(orient="records") if parser.parse_args().json else rows.to_string(index=False))


def fit_variant(dataset: Dataset, changed: tuple[str, ...]) -> dict[str, object]:
    """Return the row of one set of changed assumptions."""
    problem = make_variant(dataset, changed)
    truth = true_values()
    start = problem.parameters.theta({**truth, "bevel_spread": 0.02})
    theta = min((descend(problem, start + by) for by in STARTS), key=lambda end: end[0])[1]
    slope = problem.jacobian(theta)[1]
    sds = np.sqrt(np.diag(np.linalg.inv(slope.T @ slope)))
    row: dict[str, object] = {"changed": ", ".join(changed) or "nothing"}
    for name in ("mu1_pa", "bevel_mm"):
        k = problem.names.index(name)
        error = theta[k] - np.log(truth[name])
        row |= {f"{name}_ratio": np.exp(error), f"{name}_sd": sds[k], f"{name}_z": error / sds[k]}
    return row


def make_variant(dataset: Dataset, changed: tuple[str, ...]) -> Problem:
    """Return the problem of study 1 with these assumptions changed."""
    medium = load(find_file("medium", MEDIUM), MediumRecord)
    if EXACT in changed:
        tables = {
            name: one.model_copy(update={"spread": 1.0}) if one.tie else one
            for name, one in medium.parameters.items()
        }
        medium = medium.model_copy(update={"parameters": tables})
    some = [one for one in dataset.insertions if one.medium == MEDIUM and one.layers == 4]
    if INDEPENDENT in changed:
        some = [replace(one, boundary_shared_sd=0.0) for one in some]
    if FRICTIONLESS in changed:
        some = [remove_friction(one) for one in some]
    likelihood = LikelihoodRecord(measurement="points" if POINTS in changed else "stored")
    return make_problem(dataset, some, medium, WeightsRecord(), likelihood)


def true_values() -> Mapping[str, float]:
    """Return the true moduli (Pa) and bevel offset (mm)."""
    specimen = draw_specimen(TWIN_SEED, MEDIUM, MEDIUM)
    moduli = {f"mu{n}_pa": 1e6 * float(mu) for n, mu in enumerate(specimen.mu, start=1)}
    return {**moduli, "bevel_mm": specimen.bevel}


def remove_friction(insertion: Insertion) -> Insertion:
    """Return an insertion whose points lie where they would without the friction of the truth."""
    planned = next(plan for plan in list_planned_insertions() if plan.id == insertion.id)
    one = simulate_insertion(planned, TWIN_SEED)
    bevel, tissue = Bevel(bevel_offset(one.specimen, planned, one.deviations)), one.true_insertion.tissue
    tissues = (tissue, replace(tissue, friction=np.zeros_like(tissue.friction)))
    needle = draw_needle(TWIN_SEED)
    shapes = [simulate(needle, met, bevel, planned.depth, rules=TRUTH_OPTIONS) for met in tissues]
    s = np.linspace(0.0, planned.depth, 201)
    rubbed, free = (compute_positions(shape, s) for shape in shapes)
    moved = np.interp(insertion.planar[:, 0], rubbed[:, 0], free[:, 1] - rubbed[:, 1])
    return insertion.with_planar(insertion.planar + np.column_stack([np.zeros_like(moved), moved]))


def descend(problem: Problem, start: np.ndarray) -> tuple[float, np.ndarray]:
    bounds = (problem.lower, problem.upper)
    start = np.clip(start, *bounds)
    found = least_squares(problem.residuals, start, lambda at: problem.jacobian(at)[1], bounds=bounds)
    return float(found.cost), found.x


if __name__ == "__main__":
    main()
