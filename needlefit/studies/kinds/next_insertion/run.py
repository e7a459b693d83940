"""Rank candidates for the next insertion by their expected information gain, beside a repeat.

The gain of a candidate is the mutual information of parameters and its data, by nested Monte Carlo over the
posterior of what is known already (`inference.identifiability.design_gain`); its linear form stands beside
it. Errors of pose, depths and points are those of the insertion that the study names as a model of a new one.
All candidates predict data for the same draws: their differences are better known than their values.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import spearmanr

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion
from needlefit.errors import FitError
from needlefit.inference.identifiability.design_gain import (
    ExpectedGain,
    PredictedData,
    linearized_gain,
    nested_gain,
)
from needlefit.inference.identifiability.identify import find_fixed_shape, free_shape
from needlefit.inference.identifiability.precision import describe_combination, linearize
from needlefit.inference.likelihood.nodes import make_group
from needlefit.inference.parameters import BEVEL_SPREAD, NOISE_SCALE
from needlefit.inference.problem import Problem
from needlefit.project.random_streams import random_stream
from needlefit.studies.folds import Fold
from needlefit.studies.further_insertion import (
    WeightedPosterior,
    check_reach,
    describe_posterior,
    find_template,
    weigh_posterior,
)
from needlefit.studies.job import Job, Settings, prepare
from needlefit.studies.kinds.next_insertion.candidates import (
    CandidatePlace,
    iterate_places,
    predict_candidate,
    predict_tips,
    with_predicted_shape,
)
from needlefit.studies.kinds.next_insertion.schema import NextInsertionRecord, QuantityRecord
from needlefit.studies.planned_draws import vary_bevels
from needlefit.studies.planned_insertions import simulate_design
from needlefit.studies.run import Frames, Run
from needlefit.studies.runner import AnalysisPlan, AnalysisTask, FrameRows, Shared, run_analysis
from needlefit.studies.score import Row

OUTER_DRAWS = 400
"""Draws whose data are predicted; their scatter is the standard error of a gain."""

LINEAR_DRAWS = 24
"""Draws at which the linear gain is taken; it is their mean."""

MIN_ESS, ROUGH_NOTE = 10.0, "rough"
"""Effective sample size that a posterior must have in the median; rows with less are marked."""

LEAST_KNOWN = "least_known"
"""Name of the combination of parameters that is known worst."""

_WHERE = ("role", "entry", "angle_deg", "depth_mm")
FRAMES: Mapping[str, tuple[str, ...]] = {
    "candidates": (
        *_WHERE,
        *("layers", "boundaries_mm", "deflection_mm", "nats", "nats_se", "linear_nats"),
        *("ess", "draws", "failed_solves", "note"),
    ),
    "parameters": (*_WHERE, "parameter", "combination", "sd_now", "sd_after", "nats"),
    "tips": (*_WHERE, "tip", "sd_now_mm", "sd_after_mm", "nats"),
    "alphas": (*_WHERE, "parameter", "sd_now", "sd_after"),
    "posterior": ("insertions", "pareto_k", "sampled", "draws", "ess", "note"),
}
"""`role` is "candidate", or "repeat": the deepest insertion made so far, once more. Deviations of parameters
are of logarithms, of alpha itself; those of `alphas` are what would be left if all else were known. `ess`
is on how many draws the posterior afterwards stands."""

AGREEMENT_COLUMNS = ("candidates", "spearman", "largest_excess_nats", "same_best")
"""Columns of the agreement of the linear gain with the nested one over the candidates."""


@dataclass(frozen=True)
class _CurrentKnowledge:
    """What is known before the next insertion.

    Attributes
    ----------
    job : Job
    known : WeightedPosterior
    ridge : (P,) array
        The unit combination of theta that is known worst.
    tips : (B, T) array
        Deflections of the tips asked for, mm.
    outer_draws : (O,) array
        Draws whose data are predicted.
    """

    job: Job
    known: WeightedPosterior
    ridge: Floats
    tips: Floats
    outer_draws: NDArray[np.intp]

    @property
    def quantities(self) -> Floats:
        """Parameters, the combination known worst, tips: (B, P + 1 + T)."""
        thetas = self.known.thetas
        return np.column_stack([thetas, thetas @ self.ridge, self.tips])

    def only(self, kept: NDArray[np.bool_]) -> "_CurrentKnowledge":
        """Return the same of the draws of a mask (B,) alone."""
        # new numbers of the draws that stay
        places = np.cumsum(kept) - 1
        outer_draws = places[self.outer_draws[kept[self.outer_draws]]]
        return replace(self, known=self.known.only(kept), tips=self.tips[kept], outer_draws=outer_draws)


GetKnowledge = Callable[[], _CurrentKnowledge | None]
PredictInsertion = Callable[[_CurrentKnowledge], Insertion | None]
"""What is known now -> an insertion with the shape that is predicted of it; None where there is none."""


def run(name: str, record: NextInsertionRecord, settings: Settings) -> Run:
    """Rank the candidates of a study.

    Raises
    ------
    ConfigError, DataError
        If anything the record names is missing or wrong.
    FitError
        If the fit, or an insertion whose tip is asked for, has no solution.
    """
    job = prepare(name, record.tuning(), settings)
    like = find_template(job, record.template_insertion)
    check_reach(job, like, _largest_depths(record))
    now = Shared(partial(_find_knowledge, job, record, like, settings))
    names = tuple(one.name for one in record.quantities)
    tasks: dict[str, AnalysisTask] = {"posterior": partial(_posterior_row, now)}
    for place in iterate_places(record):
        entry, angle, depth = place
        where = dict(zip(_WHERE, ("candidate", entry.name, angle, depth), strict=True))
        key = f"{entry.name}, {angle:g} degrees, {depth:g} mm"
        tasks[key] = partial(_run_task, now, where, names, partial(_predict_candidate, like, place))
    deepest = max(job.folds[0].tune, key=lambda one: one.depth)
    where = dict(zip(_WHERE, ("repeat", deepest.id, 0.0, deepest.depth), strict=True))
    tasks["repeat"] = partial(_run_task, now, where, names, partial(_predict_repeat, deepest))
    plan = AnalysisPlan([job], tasks, FRAMES, _conclude, shared=[now])
    return run_analysis(name, record, settings, plan)


def _largest_depths(record: NextInsertionRecord) -> dict[str, float]:
    """Return the largest depth that each key of the record holds, mm."""
    entries = {f"entries.{n}.depths_mm": one.depths_mm for n, one in enumerate(record.entries, start=1)}
    wanted = {f"quantities.{n}.depth_mm": (one.depth_mm,) for n, one in enumerate(record.quantities, start=1)}
    every = {"depths_mm": record.depths_mm, **entries, **wanted}
    return {key: max(depths) for key, depths in every.items() if depths}


def _find_knowledge(
    job: Job, record: NextInsertionRecord, like: Insertion, settings: Settings
) -> _CurrentKnowledge | None:
    fitted = weigh_posterior(job, settings)
    if fitted is None:
        return None
    known = refer_to_all_needles(fitted, random_stream(job.recipe.seed, job.name, "bevels"))
    wanted = [_target_insertion(known, job, like, record, one) for one in record.quantities]
    found = np.array([predict_tips(known, insertion) for insertion in wanted]).reshape(
        len(wanted), len(known.thetas)
    )
    solved = np.isfinite(found).all(axis=0)
    kept = known.only(solved)
    outer_draws = kept.drawn(OUTER_DRAWS, random_stream(job.recipe.seed, job.name, "outer"))
    # eigenvalues ascend: the last vector has the largest variance; its sign is made unique below
    ridge = np.linalg.eigh(kept.covariance)[1][:, -1]
    upright = ridge * np.sign(ridge[np.argmax(np.abs(ridge))])
    return _CurrentKnowledge(job, kept, upright, found[:, solved].T, outer_draws)


def refer_to_all_needles(known: WeightedPosterior, rng: np.random.Generator) -> WeightedPosterior:
    """Return a posterior in which b is the mean of all needles, not of those fitted to.

    From that mean a further insertion deviates as any other: the deviations of two of them are independent.
    """
    problem = known.problem
    sd = math.sqrt(problem.new_bevel_sd**2 - 1)  # of the mean of the n fitted to: sqrt(1 / n)
    sets = vary_bevels(known.sets, sd, rng)
    return replace(known, thetas=np.array([problem.parameters.theta(values) for values in sets]))


def _target_insertion(
    known: WeightedPosterior, job: Job, like: Insertion, record: NextInsertionRecord, wanted: QuantityRecord
) -> Insertion:
    """Return the insertion whose tip is asked for."""
    entry = next(entry for entry in record.entries if entry.name == wanted.entry)
    found = predict_candidate(job, like, (entry, wanted.angle_deg, wanted.depth_mm), known.middle)
    if found is None:
        raise FitError(f"the insertion of `{wanted.name}` has no solution, or leaves the medium")
    return found


def _posterior_row(now: GetKnowledge) -> FrameRows:
    before = now()
    return {} if before is None else {"posterior": [describe_posterior(before.known)]}


def _predict_candidate(like: Insertion, place: CandidatePlace, now: _CurrentKnowledge) -> Insertion | None:
    return predict_candidate(now.job, like, place, now.known.middle)


def _predict_repeat(simulated: Insertion, now: _CurrentKnowledge) -> Insertion | None:
    """Return an insertion as it would go once more."""
    again = simulate_design(now.job, Fold("again", (simulated,), ()), now.known.middle)
    return (
        None
        if again is None
        else with_predicted_shape(now.job, replace(again.insertions[0], sd=None), now.known.middle)
    )


def _run_task(now: GetKnowledge, where: Row, names: tuple[str, ...], predict: PredictInsertion) -> FrameRows:
    """Return what one insertion is expected to tell."""
    before = now()
    if before is None:
        return {}
    insertion = predict(before)
    if insertion is None:
        return {"candidates": [{**where, "note": "no solution, or outside the medium"}]}
    problem = replace(before.known.problem, insertions=(insertion,), centred_bevels=False)
    after, gain, failed = _estimate_gain(before, problem, where)
    shape = {
        "layers": "-".join(map(str, insertion.sequence)),
        "boundaries_mm": " ".join(f"{x:.2f}" for x in insertion.boundaries),
        "deflection_mm": insertion.deflection,
    }
    found = {"nats": gain.nats, "nats_se": gain.nats_se, "linear_nats": _estimate_linear_gain(after, problem)}
    worth = {"ess": gain.effective_sample_size, "draws": len(after.known.thetas), "failed_solves": failed}
    note = {"note": ROUGH_NOTE if gain.effective_sample_size < MIN_ESS else ""}
    return {
        "candidates": [{**where, **shape, **found, **worth, **note}],
        **_quantity_rows(after, gain, where, names),
        "alphas": _shape_rows(problem, before.known.middle, where),
    }


def _estimate_gain(
    now: _CurrentKnowledge, problem: Problem, where: Row
) -> tuple[_CurrentKnowledge, ExpectedGain, int]:
    """Return what is known by the draws that can be solved, what the insertion tells, and how many cannot."""
    (evidence,) = problem.density.observations
    sets = now.known.sets
    (white,) = problem.density.whitened_residuals(sets, 1)
    solved = np.asarray(np.isfinite(white).all(axis=(1, 2)), dtype=np.bool_)
    scales = np.array([values.get(NOISE_SCALE, problem.density.scale) for values in sets])
    spreads = np.array([values.get(BEVEL_SPREAD, 0.0) for values in sets])
    kept = now.only(solved)
    rng = random_stream(now.job.recipe.seed, now.job.name, *map(str, where.values()))
    predicted = PredictedData(
        np.log(kept.known.weights),
        scales[solved],
        spreads[solved],
        white[solved],
        make_group(evidence.nodes),
    )
    return kept, nested_gain(predicted, kept.outer_draws, kept.quantities, rng), int(np.sum(~solved))


def _estimate_linear_gain(now: _CurrentKnowledge, problem: Problem) -> float:
    """Return the linear gain, its mean over draws; each is taken where its own data would be."""
    gains, covariance = [], now.known.covariance
    for theta in now.known.thetas[now.outer_draws[:LINEAR_DRAWS]]:
        simulated = with_predicted_shape(now.job, problem.insertions[0], problem.values(theta))
        if simulated is not None:
            gains.append(
                linearized_gain(covariance, linearize(replace(problem, insertions=(simulated,)), theta)[1])
            )
    return float(np.mean(gains)) if gains else float("nan")


def _quantity_rows(
    now: _CurrentKnowledge, gain: ExpectedGain, where: Row, names: tuple[str, ...]
) -> FrameRows:
    weights, quantities, free = now.known.weights, now.quantities, now.known.problem.names
    before = np.sqrt(weights @ (quantities - weights @ quantities) ** 2)
    every = list(zip(before.tolist(), gain.sds.tolist(), gain.quantity_nats.tolist(), strict=True))
    words = ["" for _ in free] + [describe_combination(now.ridge, free)]
    head = ("parameter", "combination", "sd_now", "sd_after", "nats")
    known = zip([*free, LEAST_KNOWN], words, every, strict=False)
    parameter_rows = [
        {**where, **dict(zip(head, (name, words, *three), strict=True))} for name, words, three in known
    ]
    tip_head = ("tip", "sd_now_mm", "sd_after_mm", "nats")
    pairs = zip(names, every[len(free) + 1 :], strict=True)
    return {
        "parameters": parameter_rows,
        "tips": [{**where, **dict(zip(tip_head, (name, *three), strict=True))} for name, three in pairs],
    }


def _shape_rows(problem: Problem, values: Mapping[str, float], where: Row) -> list[Row]:
    """Return what an insertion would leave of the shape parameters that are fixed, if all else were known."""
    rows = []
    for name in find_fixed_shape(problem):
        free = free_shape(problem, name)
        at = free.names.index(name)
        slope = linearize(free, free.parameters.theta(values))[1][:, at]
        before = 12.0 / float(free.upper[at] - free.lower[at]) ** 2
        after = before + float(slope @ slope)
        rows.append({**where, "parameter": name, "sd_now": before**-0.5, "sd_after": after**-0.5})
    return rows


def _conclude(frames: Frames) -> tuple[str, ...]:
    """Add how the two gains agree, and what the figure draws; return why something is not to be trusted."""
    known = frames["candidates"].dropna(subset=["nats", "linear_nats"])
    ranked = known[known["role"] == "candidate"]
    nats, linear_nats = (ranked[name].to_numpy(dtype=np.float64) for name in ("nats", "linear_nats"))
    rank = float(spearmanr(nats, linear_nats).statistic) if len(ranked) > 1 else float("nan")
    best = len(ranked) > 0 and int(np.argmax(nats)) == int(np.argmax(linear_nats))
    excess = float(np.max(linear_nats - nats)) if len(ranked) else float("nan")
    rows = [dict(zip(AGREEMENT_COLUMNS, (len(ranked), rank, excess, best), strict=True))]
    frames["agreement"] = pd.DataFrame(rows, columns=list(AGREEMENT_COLUMNS))
    frames["gains"] = _gain_table(frames)
    return tuple(fault for fault in frames["posterior"]["note"] if fault)


def _gain_table(frames: Frames) -> pd.DataFrame:
    """Return gain, and deviation of the first tip asked for, of every insertion that has a solution."""
    where, tips = list(_WHERE), frames["tips"]
    gains = frames["candidates"][[*where, "nats", "nats_se"]].dropna(subset=["nats"])
    first = tips[tips["tip"] == (tips["tip"].iloc[0] if len(tips) else "")].drop(columns="nats")
    return gains.merge(first, how="left", on=where)
