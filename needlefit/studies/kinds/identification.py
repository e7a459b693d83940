"""Find what the insertions of a design determine, before any measured shape, and what one more would add.

Candidates for it are the other insertions of the dataset into the media that are tuned on, each as if it went
into the specimen of the design, and a repeat of the deepest insertion of the design. The gain of a candidate
is the mutual information of parameters and its data, by nested Monte Carlo over the posterior that the design
would leave. All candidates predict data for the same draws: differences are better known than values.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pandas as pd

from needlefit.arrays import Bools, Floats
from needlefit.datasets.folds import Fold
from needlefit.datasets.insertion import Insertion
from needlefit.errors import ConfigError, FitError
from needlefit.inference.draw_simulation import vary_bevels
from needlefit.inference.fit import Fit
from needlefit.inference.identifiability.design_gain import PredictedData, fisher_information, nested_gain
from needlefit.inference.identifiability.fit_profiles import profile_parameters
from needlefit.inference.identifiability.information import (
    compute_sds,
    cramer_rao,
    linearize,
    prior_information,
)
from needlefit.inference.identifiability.loosened_assumptions import loosen
from needlefit.inference.identifiability.profile import minimize_squares
from needlefit.inference.identifiability.verdict import find_together
from needlefit.inference.likelihood.nodes import make_group
from needlefit.inference.likelihood.observations import OBSERVATIONS
from needlefit.inference.parameter_names import BEVEL_SPREAD, NOISE_SCALE
from needlefit.inference.prior_shift import measure_shifts
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.importance import Effort, sample_about_modes
from needlefit.inference.sampling.pareto_smoothing import MAX_PARETO_K
from needlefit.reporting.table import Table, TableLayout
from needlefit.reporting.table_files import Row, to_records
from needlefit.reporting.text import KindText
from needlefit.schemas.run_metadata import IdentificationMetadata
from needlefit.schemas.study import TargetRecord
from needlefit.studies import fit_figures
from needlefit.studies.first_page import FirstPage, Verdict, advise
from needlefit.studies.identification import (
    IDENTIFICATION_COLUMNS,
    PROFILE_COLUMNS,
    identify_parameters,
    lay_out_identification,
    list_held,
)
from needlefit.studies.job import Job, Settings
from needlefit.studies.kind import StudyKind
from needlefit.studies.load import begin_run, prepare_target
from needlefit.studies.report import StudyReport
from needlefit.studies.run import Run
from needlefit.studies.simulated_design import choose_reference_values, simulate_design


class IdentificationRecord(TargetRecord):
    """`kind = "identification"`: which parameters the design of the insertions determines."""

    kind: Literal["identification"]


#: kind of study that `needlefit tune --design` runs, or a study file
KIND = StudyKind("identification", IdentificationRecord, __name__, IdentificationMetadata)

CANDIDATE_COLUMNS = (
    *("role", "insertion", "layers", "depth_mm", "deflection_mm"),
    *("nats", "nats_se", "sd_now", "sd_after", "ess", "note"),
)
"""`role` is "candidate" or "repeat". `sd_now`, `sd_after`: of the combination of parameters that the design
determines worst, without and with the insertion. `ess`: on how many draws the posterior afterwards stands."""

MAX_CANDIDATES = 24  #: largest number of candidates; of more, some are chosen, evenly in depth
#: number of points of a candidate: errors of neighbours are alike, so that more add next to nothing
MEASURED_POINTS = 31
OUTER_DRAWS = 200  #: number of draws whose data are predicted; their scatter is the standard error of a gain
#: effort of sampling; a gain shows in how few of the draws are left
EFFORT = Effort(draws=500, min_ess=1000.0)
DROPPED_WEIGHT = 1e-3  #: total weight of the lightest draws, which are left out
MIN_ESS = 10.0  #: smallest effective number of draws, in the median, of a gain that is not rough

FRAMES: Mapping[str, tuple[str, ...]] = {
    "identify": IDENTIFICATION_COLUMNS,
    "candidates": CANDIDATE_COLUMNS,
}


def run(name: str, record: IdentificationRecord, settings: Settings) -> Run:
    """Find what depths, layers, sides, poses and noise of the insertions identify.

    The planned shapes are those of the paper's parameters, or of the middle of the bounds.

    Raises ConfigError or DataError if anything the record names is missing or wrong, or no noise is stated.
    FitError if the planned insertions have no solution there.
    """
    job = prepare_target(record, settings, "-design")
    title = job.record.title or job.name.removesuffix("-design")
    about = begin_run(name, record, job, f"Identification: {title}")
    fold = job.folds[0]
    if not job.parameters.searched.free:
        raise ConfigError(
            "the medium leaves no parameter free: there is nothing to determine",
            where=job.place_in_medium("parameters"),
            fix="give at least one parameter bounds instead of `fixed`",
        )
    values, place = choose_reference_values(job)
    problem = simulate_design(job.problem(fold), values)
    if problem is None:
        raise FitError(
            f"the planned insertions have no solution at {place}",
            fix="name a set of the paper's parameters (`paper_parameters`), or narrow the bounds",
        )
    theta = problem.parameters.theta(values)
    shifts = measure_shifts(problem, theta[None])
    problem = problem.holding([name for name, shift in shifts.items() if shift.is_hidden])
    parameters, problem = problem.parameters, problem.searched
    theta = parameters.restrict(theta)
    here = Fit(tuple(theta.tolist()), problem.values(theta), 0.0, (), 0, 0, False)
    sds = dict(zip(problem.names, cramer_rao(fisher_information(problem, theta)).tolist(), strict=True))
    profiles = profile_parameters(problem, here, settings.jobs, settings.stop)
    linearized = linearize(problem, theta)
    information = compute_sds(problem, theta, linearized=linearized)[1]
    together = find_together(problem.names, information, prior_information(problem))
    loosened = loosen(problem, theta, linearized=linearized)
    identified = identify_parameters(problem, profiles, sds, loosened=loosened, together=together)
    rows = [{"fold": fold.name, **row, "value": values[row["parameter"]]} for row in identified.rows]
    rows += [{"fold": fold.name, **row} for row in list_held(parameters, shifts)]
    columns = [n for n in job.parameters.names if any(n in row for row in identified.points)]
    depths = [insertion.depth for insertion in fold.tune]
    metadata = about.metadata.extend(
        IdentificationMetadata,
        place=place,
        values=problem.values(theta),
        insertions=len(depths),
        depths_mm=[min(depths), max(depths)],
    )
    frames = {
        "identify": pd.DataFrame(rows, columns=list(FRAMES["identify"])),
        "profiles": pd.DataFrame(
            [{"fold": fold.name, **row} for row in identified.points], columns=[*PROFILE_COLUMNS, *columns]
        ),
        "candidates": rank_candidates(job, fold, problem, theta, settings),
    }
    return replace(about, frames=frames, metadata=metadata, interrupted=settings.stop())


# ---- what one more insertion would add


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
    rng = job.random(job.name, "candidates")
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


# ---- the report

TEXT = KindText("identification")


def describe_identification(run: Run) -> dict[str, Any]:
    """Return what the text prints: the free parameters by what the design determines of them."""
    design, candidates = run.frames["identify"], run.frames["candidates"]
    stated = run.knows(IdentificationMetadata)
    free = design.groupby("determined")["parameter"].agg(list)
    words = {"known": "yes", "together": "only together", "loose": "no"}
    ranked = to_records(candidates[candidates["nats"].notna()])
    return {
        **{key: free.get(word, []) for key, word in words.items()},
        "best": ranked[0] if ranked else None,
        "insertions": stated.insertions,
        "depths": list(dict.fromkeys(f"{depth:.3g}" for depth in stated.depths_mm)),
        "place": stated.place,
        "name": stated.name,
    }


def judge_design(run: Run) -> FirstPage:
    """Return which parameters are identifiable from the design."""
    values = describe_identification(run)
    count, total = len(values["known"]), sum(len(values[name]) for name in ("known", "together", "loose"))
    numbers = {"identifiable": count, "parameters": total}
    verdict = Verdict(TEXT.sentence("answer", values), "pass" if count == total else "warn", numbers)
    best = values["best"]
    ranked = [] if best is None else ["repeat_best" if best["role"] == "repeat" else "insertion_best"]
    about, advice = TEXT.sentence("about", values), advise(ranked, values)
    return FirstPage(verdict, about, REPORT.lay_out(run)[:1], advice=advice)


def lay_out_design(run: Run) -> list[Table | TableLayout]:
    """Return the parameters, and the candidates for a further insertion that have a solution."""
    parameters, candidates = (
        lay_out_identification(run.frames["identify"], expected=True),
        run.frames["candidates"],
    )
    rows = [
        {**row, "layers_passed": row["layers"], "repeated": row["role"] == "repeat"}
        for row in to_records(candidates[candidates["nats"].notna()])
    ]
    columns = ("insertion", "layers_passed", "depth_mm", "deflection_mm", "gain", "worst_known_sd")
    return [parameters, *([Table("candidates", rows, columns, strong="repeated")] if rows else [])]


REPORT = StudyReport(
    TEXT,
    describe_identification,
    lay_out_design,
    lambda run: {"profiles": fit_figures.draw_profiles(run.frames["identify"], run.frames["profiles"])},
    judge_design,
)
