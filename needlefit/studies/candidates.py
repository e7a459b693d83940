"""Rank further insertions by what they would add to a design: their expected information gain.

Candidates are the other insertions of the dataset into the media that are tuned on, each as if it went into
the specimen of the design, and a repeat of the deepest insertion of the design. The gain of a candidate is
the mutual information of parameters and its data, by nested Monte Carlo over the posterior that the design
would leave. All candidates predict data for the same draws: differences are better known than values.
"""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pandas as pd

from needlefit.arrays import Bools, Floats
from needlefit.datasets.folds import Fold
from needlefit.datasets.insertion import Insertion
from needlefit.inference.draw_simulation import vary_bevels
from needlefit.inference.identifiability.design_gain import PredictedData, nested_gain
from needlefit.inference.identifiability.profile import minimize_squares
from needlefit.inference.likelihood.nodes import make_group
from needlefit.inference.likelihood.observations import OBSERVATIONS
from needlefit.inference.parameter_names import BEVEL_SPREAD, NOISE_SCALE
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.importance import MAX_PARETO_K, Effort, sample_about_modes
from needlefit.project.random_streams import random_stream
from needlefit.reporting.table import Table
from needlefit.reporting.table_files import Row, to_records
from needlefit.studies.job import Job, Settings
from needlefit.studies.simulated_data import simulate_design

CANDIDATE_COLUMNS = (
    *("role", "insertion", "layers", "depth_mm", "deflection_mm"),
    *("nats", "nats_se", "sd_now", "sd_after", "ess", "note"),
)
"""`role` is "candidate" or "repeat". `sd_now`, `sd_after`: of the combination of parameters that the design
determines worst, without and with the insertion. `ess`: on how many draws the posterior afterwards stands."""

MAX_CANDIDATES = 24  #: of more, some are chosen, evenly in depth
MEASURED_POINTS = 31  #: of a candidate: neighbours err alike, so that more add next to nothing
OUTER_DRAWS = 200  #: draws whose data are predicted; their scatter is the standard error of a gain
EFFORT = Effort(draws=500, min_ess=1000.0)  #: the gain is seen by how few of the draws are left
DROPPED_WEIGHT = 1e-3  #: the lightest draws, of this weight together, are left out
MIN_ESS = 10.0  #: with fewer draws left, in the median, a gain is rough


def list_insertion_candidates(job: Job, fold: Fold) -> Iterator[tuple[str, Insertion]]:
    """Yield role and insertion: those that are not tuned on, by depth, then the deepest of those that are."""
    tuned, media = {insertion.id for insertion in fold.tune}, {insertion.medium for insertion in fold.tune}
    others = [
        insertion
        for insertion in job.dataset.insertions
        if insertion.medium in media and insertion.id not in tuned
    ]
    others = [other for other in others if max(other.sequence) <= job.medium.layers]
    others.sort(key=lambda other: (other.depth, other.id))
    places = np.linspace(0, len(others) - 1, min(len(others), MAX_CANDIDATES)).round().astype(int)
    yield from (("candidate", others[place]) for place in places)
    yield "repeat", max(fold.tune, key=lambda insertion: insertion.depth)


def rank_candidates(
    job: Job, fold: Fold, problem: Problem, theta: Floats, settings: Settings
) -> pd.DataFrame:
    """Return the expected gain of every candidate, the largest first; `CANDIDATE_COLUMNS`.

    `problem` has the measured shapes that the parameters `theta` (P,) predict for the design. Parameters that
    are held stay at the centre of their prior.
    """
    problem, theta = problem.searched, problem.parameters.restrict(theta)
    rng = random_stream(job.recipe.seed, job.name, "candidates")
    draws = sample_about_modes(problem, [minimize_squares(problem, theta)], rng, settings.jobs, (EFFORT,))
    weights = np.exp(draws.log_weights)
    order = np.argsort(weights, kind="stable")
    heavy = np.sort(order[np.cumsum(weights[order]) > DROPPED_WEIGHT])
    weights = weights[heavy] / weights[heavy].sum()
    # b is the mean of all needles, not of those tuned on: of a further one it deviates independently
    sd = math.sqrt(max(0.0, problem.new_bevel_sd**2 - 1))
    sets = vary_bevels([problem.values(values) for values in draws.thetas[heavy]], sd, rng)
    thetas = np.array([problem.parameters.theta(values) for values in sets])
    away = thetas - weights @ thetas
    worst = away @ np.linalg.eigh((away * weights[:, None]).T @ away)[1][:, -1]  # (B,) the widest axis
    outer = rng.choice(len(weights), size=OUTER_DRAWS, p=weights)
    values, rows = problem.values(theta), list[Row]()
    for role, insertion in list_insertion_candidates(job, fold):
        if settings.stop():
            break
        row: Row = {"role": role, "insertion": insertion.id, "depth_mm": insertion.depth}
        thin = OBSERVATIONS[insertion.observation].thin(insertion, MEASURED_POINTS)
        planned = simulate_design(replace(job.problem(fold), insertions=(thin,)), values)
        if planned is None:
            rows.append(row | {"note": "no solution, or outside the medium"})
            continue
        (made,) = planned.insertions
        alone = replace(planned, centred_bevels=False)
        (white,) = alone.density.whitened_residuals(sets, settings.jobs)
        solved: Bools = np.all(np.isfinite(white), axis=(1, 2))
        places = np.cumsum(solved) - 1  # new numbers of the draws that have a solution
        kept = [values for values, has in zip(sets, solved, strict=True) if has]
        data = PredictedData(
            np.log(weights[solved] / weights[solved].sum()),
            np.array([values.get(NOISE_SCALE, alone.density.scale) for values in kept]),
            np.array([values.get(BEVEL_SPREAD, 0.0) for values in kept]),
            white[solved],
            make_group(alone.density.observations[0].nodes),
        )
        gain = nested_gain(data, places[outer[solved[outer]]], worst[solved, None], rng)
        rough = gain.effective_sample_size < MIN_ESS or draws.k > MAX_PARETO_K
        rows.append(
            row
            | {"layers": "-".join(map(str, made.sequence)), "deflection_mm": made.deflection}
            | {"nats": gain.nats, "nats_se": gain.nats_se, "ess": gain.effective_sample_size}
            | {"sd_now": math.sqrt(weights @ worst**2), "sd_after": float(gain.sds[0])}
            | {"note": "rough" if rough else ""}
        )
    frame = pd.DataFrame(rows, columns=list(CANDIDATE_COLUMNS))
    return frame.sort_values("nats", ascending=False, kind="stable", ignore_index=True)


def lay_out_candidates(candidates: pd.DataFrame) -> list[Table]:
    """Return the table of the candidates that have a solution; none after a stop."""
    rows = [
        {**row, "layers_passed": row["layers"], "repeated": row["role"] == "repeat"}
        for row in to_records(candidates[candidates["nats"].notna()])
    ]
    columns = ("insertion", "layers_passed", "depth_mm", "deflection_mm", "gain", "worst_known_sd")
    return [Table("candidates", rows, columns, strong="repeated")] if rows else []
