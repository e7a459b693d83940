"""Compare which model predicts best: tissue laws and empirical curves, on needles that they were not fitted
to.

Every candidate has a posterior, by one likelihood, of its own parameters and of one factor of the noise, so
that what it misses is paid for as noise. How probable it makes a needle y that was held out of the data D,

    log p(y | D) = log of the mean, over the posterior of D, of p(y | theta) = log Z(D, y) - log Z(D),

y being all its points together, is the ratio of two evidences (`inference.sampling.importance`), each by
importance about its own peaks: errors of points, pose and depths as the likelihood has them, and the layers
that the fit to D meets on the planned path of y, the same for all theta.

Differences of log p between two candidates are taken needle by needle, summed over depths of one hole
(needles of one specimen where there are enough), and their sum over G groups has the standard error
sqrt(G) sd (A. Vehtari, A. Gelman, J. Gabry, Stat. Comput. 27 (2017) 1413, section 5; too small where G is:
T. Sivula, M. Magnusson, A. A. Matamoros, A. Vehtari, arXiv 2008.10296). What the draws behind both leave open
is added to it in squares. A difference of less than two standard errors is a tie.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, Self

import numpy as np
import pandas as pd
from pydantic import Field, model_validator

from needlefit.datasets.insertion import Insertion
from needlefit.datasets.select import group_insertions
from needlefit.errors import ConfigError
from needlefit.inference.baseline_fit import CurveDensity
from needlefit.inference.baselines import list_baselines
from needlefit.inference.identifiability.profile import minimize_squares
from needlefit.inference.parameters import (
    NOISE_SCALE,
    Parameters,
    dimension,
    is_shape_parameter,
    with_hyperparameters,
)
from needlefit.inference.planned_layers import with_planned_layers
from needlefit.inference.problem import Problem
from needlefit.inference.sampling import importance
from needlefit.inference.sampling.log_density import approximate_by_laplace
from needlefit.mechanics.laws import LAWS
from needlefit.metrics import headline_metrics
from needlefit.project.locate import find_file
from needlefit.project.random_streams import random_stream
from needlefit.project.toml import describe_key, load, locate_key, renamed_keys
from needlefit.reporting.columns import DIGITS
from needlefit.reporting.figures import Drawing, Look
from needlefit.reporting.labels import GREEN, GREY, METHOD_COLOURS, candidate_name
from needlefit.reporting.number_format import join_metrics
from needlefit.reporting.table import Table
from needlefit.reporting.table_files import to_records
from needlefit.reporting.text import KindText
from needlefit.schemas.analyses import AnalysisRecord, SyntheticDataRecord
from needlefit.schemas.medium import MediumRecord, ParameterRecord, use_path_angle
from needlefit.schemas.recipe import RecipeRecord
from needlefit.schemas.study import FitRecord, LayerCountRule, SelectionRecord
from needlefit.studies.fit_frames import list_score_columns
from needlefit.studies.held_out_predictions import find_fit
from needlefit.studies.job import Fold, Job, Settings, prepare
from needlefit.studies.kind import StudyKind
from needlefit.studies.report import StudyReport
from needlefit.studies.run import Frames, Run, Verdict, headline_fault
from needlefit.studies.runner import AnalysisPlan, AnalysisTask, FrameRows, list_faults, run_analysis
from needlefit.studies.score import (
    Predictor,
    Row,
    curve_predictor,
    model_predictor,
    score_planned,
)
from needlefit.studies.simulated_data import simulate_dataset

PATH_ANGLE = "path_angle"  #: the candidate that advances by the path angle, in the tissue law of the medium


def _list_curves() -> tuple[str, ...]:
    return tuple(baseline.name for baseline in list_baselines() if baseline.has_posterior)


class ComparisonRecord(AnalysisRecord):
    """`kind = "comparison"`: cross-validated comparison of tissue laws and empirical curves."""

    kind: Literal["comparison"]
    dataset: str | None = None
    """Name of a dataset in `data/`, or the path of its folder."""
    synthetic: SyntheticDataRecord | None = None
    """Data simulated for this study, in place of `dataset`."""
    medium: str
    """Name of a tissue model in `configs/media/`: layers and bounds of all laws."""
    recipe: str = "default"
    """Name of a recipe in `configs/recipes/`, or the path of its file."""
    layer_count_rule: LayerCountRule = "listed"
    """Number of layers of an insertion that ends at a boundary: as its row lists it, or the other count."""
    insertions: SelectionRecord = SelectionRecord()
    """Insertions that are compared."""
    candidates: tuple[str, ...] = Field(
        default_factory=lambda: ("ogden", "linear", "neo_hookean", *reversed(_list_curves()))
    )
    """Tissue laws, "path_angle" (the other rule of advance), and empirical curves."""
    reference: str = "ogden"
    """The candidate that the others are compared with."""
    folds: int = Field(default=4, ge=2)
    """Folds of the cross-validation."""
    positive_control: bool = False
    """Whether the reference must be better than every other candidate for the comparison to count."""

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if self.dataset is None and self.synthetic is None:
            raise ValueError("neither dataset nor [synthetic] is given: give one of them")
        if self.dataset is not None and self.synthetic is not None:
            raise ValueError("both dataset and [synthetic] are given: give one of them")
        known = (*LAWS.names(), PATH_ANGLE, *_list_curves())
        for name in self.candidates:
            if name not in known:
                raise ValueError(f"there is no candidate `{name}`: use some of {', '.join(known)}")
        if self.reference not in self.candidates:
            raise ValueError(f"the reference {self.reference} is not among the candidates")
        return self


KIND = StudyKind("comparison", ComparisonRecord, __name__)

SIGNIFICANT_SE = 2.0  #: standard errors from which on a difference is taken for one

AHEAD, BEHIND, TIE, REFERENCE = "ahead", "behind", "tie", "reference"

_WHERE = ("method", "fold")
_SCORED = ("depth_mm", "comparison", "converged")

FRAMES: Mapping[str, tuple[str, ...]] = {
    "scores": (
        *(*_WHERE, "insertion", "group", "points"),
        *("log_density", "log_density_se", "shared_se", "pareto_k", "ess"),
        *_SCORED,  # and the columns of headline metrics
    ),
    "fits": (*_WHERE, "pareto_k", "parameter", "value"),
}
"""`log_density` is of all points of a needle together, in mm^-points; `log_density_se` its Monte Carlo error,
`shared_se` the part of it that is the same for all needles of a fold; `pareto_k` the larger of its two
integrals'."""


# ---- one candidate, and the predictive density of another insertion

FURTHER_EFFORTS = (importance.Effort(draws=125, min_ess=125.0), *importance.EFFORTS)
"""Efforts for the evidence with one insertion more, whose Monte Carlo error is its own; that of the evidence
without it is shared by all insertions of a fold."""

MAX_NOISE_FACTOR = 1000.0
"""Largest noise factor: a candidate that misses by millimetres where points err by hundredths needs it."""


@dataclass(frozen=True)
class ModelCandidate:
    """A fitted candidate: its parameters, its curve and its posterior.

    `values` are those of its greatest density (Pa, mm; curves: mm^-(k + 1)), the noise factor among them;
    `after` is its posterior after a further insertion, None where it has no simulated needle.
    """

    values: Mapping[str, float]
    predictor: Predictor  #: the curve of these
    known: importance.WeightedDraws
    after: Callable[[Insertion], importance.WeightedDraws | None]

    def predict_density(self, insertion: Insertion) -> importance.PredictiveDensity:
        """Return the predictive density of all points of an insertion together."""
        both = self.after(insertion)
        return (
            importance.ZERO_DENSITY
            if both is None
            else importance.compute_predictive_density(both, self.known)
        )


def fit_candidate(name: str, job: Job, fold: Fold, settings: Settings) -> ModelCandidate | None:
    """Fit the candidate `name` to the insertions of a fold; None after a stop."""
    simulated = name in LAWS or name == PATH_ANGLE
    return _fit_law(job, fold, settings) if simulated else _fit_curve(name, job, fold)


def candidate_job(name: str, job: Job) -> Job:
    """Return the job of one candidate: with its law or rule, if it is one, and an estimated noise factor."""
    medium = _with_law(job.medium, name) if name in LAWS else job.medium
    medium = use_path_angle(medium) if name == PATH_ANGLE else medium
    # empirical curves are given from the entry on, so all candidates are compared by the stored points
    likelihood = job.recipe.likelihood.model_copy(
        update={"noise_scale": "estimated", "measurement": "points"}
    )
    return replace(
        job,
        name=f"{job.name} {name}",
        medium=medium,
        parameters=with_hyperparameters(Parameters.from_record(medium), likelihood, MAX_NOISE_FACTOR),
        recipe=job.recipe.model_copy(update={"likelihood": likelihood}),
        hand_tuned=None,
    )


def _with_law(medium: MediumRecord, law: str) -> MediumRecord:
    """Return the medium of another law: its shape parameters are kept to what that law is meant for.

    Those that the other law does not have are left out; those that only it has are free.
    """
    names, bounds = (
        LAWS[law].shape_names or ("alpha",),
        {one.name: one.bounds for one in LAWS[law].parameters},
    )
    changed = {}
    for name, parameter in medium.parameters.items():
        kept = parameter
        if is_shape_parameter(name):
            if dimension(name) not in names:
                continue
            if not bounds:
                kept = ParameterRecord(fixed=1.0)
            else:
                low, high = bounds[dimension(name)]
                if parameter.bounds is not None:
                    narrower = max(parameter.bounds[0], low), min(parameter.bounds[1], high)
                    kept = parameter.model_copy(update={"bounds": narrower})
                elif parameter.fixed is not None:
                    kept = parameter.model_copy(update={"fixed": min(max(parameter.fixed, low), high)})
        changed[name] = kept
    return medium.model_copy(update={"law": law, "parameters": changed})


def _fit_law(job: Job, fold: Fold, settings: Settings) -> ModelCandidate | None:
    problem, seed, needle = job.problem(fold), job.recipe.seed, job.dataset.needle
    fit = find_fit(job, problem, (fold.name,), settings)
    if settings.stop():
        return None
    ends = importance.find_modes(fit, problem.upper - problem.lower)

    def sample(
        target: Problem, rng: np.random.Generator, efforts: Sequence[importance.Effort]
    ) -> importance.WeightedDraws | None:
        # the modes move when an insertion is added
        modes = [one for one in (minimize_squares(target, end) for end in ends) if np.isfinite(one.value)]
        return importance.sample_about_modes(target, modes, rng, settings.jobs, efforts) if modes else None

    def after(insertion: Insertion) -> importance.WeightedDraws | None:
        met = with_planned_layers(insertion, fit.values, job.medium, needle)
        if met is None:
            return None
        both = replace(problem, insertions=(*problem.insertions, met))
        rng = random_stream(seed, job.name, fold.name, "weighed", insertion.id)
        return sample(both, rng, FURTHER_EFFORTS)

    known = sample(problem, random_stream(seed, job.name, fold.name, "weighed"), importance.EFFORTS)
    assert known is not None  # the fit has a needle
    return ModelCandidate(fit.values, model_predictor(fit.values, job.medium, job.dataset), known, after)


def _fit_curve(name: str, job: Job, fold: Fold) -> ModelCandidate:
    density = CurveDensity(name, job.dataset, fold.tune, job.recipe.likelihood, MAX_NOISE_FACTOR)

    def after(*insertions: Insertion) -> importance.WeightedDraws:
        both = replace(density, insertions=(*fold.tune, *insertions))
        peak = both.find_peak(density.peak) if insertions else density.peak
        about = [approximate_by_laplace(both, peak, both.lower, both.upper)]
        keys = (one.id for one in insertions)
        rng = random_stream(job.recipe.seed, job.name, fold.name, "weighed", *keys)
        efforts = FURTHER_EFFORTS if insertions else importance.EFFORTS
        return importance.sample_by_importance(both, about, (both.lower, both.upper), rng, efforts)

    best = density.curve(density.peak)
    coefficients = {f"c{k}": value for k, value in enumerate(best.coefficients)}
    values = {**coefficients, NOISE_SCALE: float(np.exp(density.peak[-1]))}
    return ModelCandidate(values, curve_predictor(best.curve), after(), after)


# ---- the tasks, and the comparison of all


def run(name: str, record: ComparisonRecord, settings: Settings) -> Run:
    return run_analysis(name, record, settings, plan(record, _prepare_job(name, record, settings), settings))


def plan(record: ComparisonRecord, job: Job, settings: Settings) -> AnalysisPlan:
    """Return the tasks: one for each candidate and fold."""
    jobs = {name: candidate_job(name, job) for name in record.candidates}
    tasks: dict[str, AnalysisTask] = {
        f"{name}, {fold.name}": partial(_run_task, name, jobs[name], fold, settings)
        for name in record.candidates
        for fold in job.folds
    }
    parameters = {str(name): each.parameters for name, each in jobs.items()}
    frames = {**FRAMES, "scores": (*FRAMES["scores"], *list_score_columns(headline_metrics()))}
    return AnalysisPlan(tuple(jobs.values()), tasks, frames, partial(conclude, record), parameters=parameters)


def _prepare_job(name: str, record: ComparisonRecord, settings: Settings) -> Job:
    table = {"schema": FitRecord.SCHEMA, "dataset": record.dataset or name, "medium": record.medium}
    how = {"recipe": record.recipe, "layer_count_rule": record.layer_count_rule, "tune": record.insertions}
    fit = FitRecord.model_validate({**table, **how})
    made = None
    if record.synthetic is not None:
        recipe = load(find_file("recipe", record.recipe), RecipeRecord)
        medium = load(find_file("medium", record.medium), MediumRecord)
        seed = recipe.seed if settings.seed is None else settings.seed
        made = simulate_dataset(name, record.synthetic, medium, seed)
    with renamed_keys({"tune": "insertions"}):
        job = prepare(name, fit, settings, made)
    if job.recipe.minimize != "posterior":
        stated = job.dataset.noise.stated
        raise ConfigError(
            "densities need the errors of the points",
            where=f"study {name}" if stated else locate_key(job.dataset.path, "noise.point_sd_mm"),
            key="recipe" if stated else "",
            expected='a dataset that states its noise, and a recipe with minimize = "posterior"',
        )
    chosen = job.folds[0].tune
    if len(set(groups := group_insertions(job.dataset, chosen))) < 2:
        raise ConfigError(
            "there is only one group of repeats: none can be left out",
            where=describe_key(name, "folds"),
            key="folds",
            expected="insertions of two groups, at least",
            fix="select more in [insertions]",
        )
    return replace(job, folds=deal_folds(chosen, groups, record.folds))


def deal_folds(insertions: tuple[Insertion, ...], groups: Sequence[str], count: int) -> tuple[Fold, ...]:
    """Return folds to which needles, or groups of repeats, are assigned in turn.

    Raises ConfigError if there are fewer of these than folds.
    """
    most = len(set(groups))
    if count > most:
        raise ConfigError(
            f"{count} folds cannot be dealt from {most} groups of repeats",
            key="folds",
            expected=f"{most} at most",
        )
    order = {group: k % count for k, group in enumerate(dict.fromkeys(groups))}
    folds = []
    for k in range(count):
        held = [order[group] == k for group in groups]
        tune, validate = (
            tuple(one for one, own in zip(insertions, held, strict=True) if own == side)
            for side in (False, True)
        )
        folds.append(Fold(f"fold {k + 1}", tune, validate))
    return tuple(folds)


def _run_task(name: str, job: Job, fold: Fold, settings: Settings) -> FrameRows:
    """Fit one candidate to all folds but one, and ask how probable it makes that one."""
    found = fit_candidate(name, job, fold, settings)
    if found is None:
        return {}
    head: Row = {"method": name, "fold": fold.name}
    together = group_insertions(job.dataset, (*fold.tune, *fold.validate))[len(fold.tune) :]
    scores = []
    for insertion, group in zip(fold.validate, together, strict=True):
        scored = score_planned(job, insertion, found.predictor)
        predicted = found.predict_density(insertion)
        row = {
            "group": group,
            "insertion": insertion.id,
            "points": len(insertion.planar),
            "log_density": predicted.log_density,
            "log_density_se": predicted.se,
            "shared_se": predicted.shared_se,
            "pareto_k": predicted.k,
            "ess": predicted.effective_sample_size,
        }
        errors = {key: scored[key] for key in (*_SCORED, *list_score_columns(headline_metrics()))}
        scores.append({**head, **row, **errors})
    about = {**head, "pareto_k": found.known.k}
    fits = [{**about, "parameter": key, "value": value} for key, value in found.values.items()]
    return {"scores": scores, "fits": fits}


def conclude(record: ComparisonRecord, frames: Frames) -> tuple[str, ...]:
    """Add the tables `differences`, `group_differences` and `comparison`; return the faults."""
    numbers = ("log_density", *list_score_columns(headline_metrics()))
    scores = frames["scores"].astype(dict.fromkeys(numbers, float))
    # every candidate's log density of each needle, less the reference's
    own = scores[scores["method"] == record.reference].set_index("insertion")["log_density"]
    with np.errstate(invalid="ignore"):
        difference = scores["log_density"] - scores["insertion"].map(own)
    compared = scores[["method", "fold", "insertion", "group", "points"]]
    frames["differences"] = compared.assign(difference=difference)
    rows = list(_comparison_rows(record, frames["differences"], scores, frames["fits"]))
    frames["comparison"] = pd.DataFrame(rows)
    frames["group_differences"] = pd.DataFrame(list(_group_rows(frames["differences"], rows)))
    typed = frames["scores"].astype({"converged": bool, "log_density": float, "pareto_k": float})
    counts = {
        "simulations of held-out insertions did not converge": ~typed["converged"],
        "held-out insertions have no density": ~np.isfinite(typed["log_density"]),
        f"log densities are not certified: Pareto k above {importance.MAX_PARETO_K}": typed["pareto_k"]
        > importance.MAX_PARETO_K,
    }
    faults = list_faults({words: int(lost.sum()) for words, lost in counts.items()})
    missed = [row["method"] for row in rows if row["verdict"] in (TIE, AHEAD)]
    if not (record.positive_control and missed):
        return faults
    # a comparison that misses a difference that was put in could not tell one elsewhere
    return (
        *faults,
        f"{record.reference} made these data and is not found ahead of {', '.join(missed)}: this "
        "comparison could not distinguish them elsewhere either",
    )


def sum_differences(differences: pd.Series, groups: pd.Series) -> tuple[float, float, int]:
    """Return the sum of differences, its standard error over groups, and the number of groups."""
    by = differences.groupby(groups, sort=False).sum()
    error = np.sqrt(len(by)) * by.std(ddof=1) if len(by) > 1 else np.nan
    return float(by.sum()), float(error), len(by)


def monte_carlo_error(scores: pd.DataFrame) -> float:
    """Return the Monte Carlo error of the sum of one candidate's log predictive densities.

    What the needles of a fold share is the same error in all of them: it adds up, and does not average out.
    """
    whole, shared = (scores[key].astype(float) for key in ("log_density_se", "shared_se"))
    folds = shared.groupby(scores["fold"]).sum()
    # the shared error is subtracted per needle and added back once per fold, as a sum: it does not average
    # out
    return float(np.sqrt((whole**2 - shared**2).sum() + (folds**2).sum()))


def verdict(difference: float, error: float) -> str:
    """Return whether a candidate is ahead of the reference, behind it, or not significantly different."""
    # written with `not`, so that a NaN is a tie
    if not abs(difference) > SIGNIFICANT_SE * error:
        return TIE
    return AHEAD if difference > 0 else BEHIND


def _comparison_rows(
    record: ComparisonRecord, differences: pd.DataFrame, scores: pd.DataFrame, fits: pd.DataFrame
) -> Iterator[Row]:
    """Yield one row for each candidate; what draws leave open adds to the scatter between groups."""
    reference = monte_carlo_error(scores[scores["method"] == record.reference])
    for name in record.candidates:
        own, scored = differences[differences["method"] == name], scores[scores["method"] == name]
        fitted = fits[fits["method"] == name]
        difference, scatter, count = sum_differences(own["difference"], own["group"])
        drawn = monte_carlo_error(scored)
        error = math.hypot(scatter, drawn, reference) if name != record.reference else 0.0
        scale = fitted.loc[fitted["parameter"] == NOISE_SCALE, "value"].astype(float)
        yield {
            "method": name,
            "insertions": len(own),
            "groups": count,
            "log_density": float(scored["log_density"].sum()),
            "difference": difference,
            "difference_se": error,
            "verdict": REFERENCE if name == record.reference else verdict(difference, error),
            "draws_se": drawn,
            **{column: float(scored[column].mean()) for column in list_score_columns(headline_metrics())},
            "noise_scale": float(np.exp(np.log(scale).mean())),
            "pareto_k": float(scored["pareto_k"].astype(float).max()),
            "ess": float(scored["ess"].astype(float).min()),
        }


def _group_rows(differences: pd.DataFrame, rows: list[Row]) -> Iterator[Row]:
    """Yield the differences of every group, and their mean with two standard errors, as "mean"."""
    for row in rows:
        if row["verdict"] == REFERENCE:
            continue
        own = differences[differences["method"] == row["method"]]
        each = own.groupby("group", sort=False)["difference"].sum()
        for group, value in each.items():
            yield {"method": row["method"], "group": group, "difference": value}
        mean, error = (row[key] / row["groups"] for key in ("difference", "difference_se"))
        ends = {"low": mean - SIGNIFICANT_SE * error, "high": mean + SIGNIFICANT_SE * error}
        about = {"method": row["method"], "group": "mean", "difference": mean}
        yield {**about, **ends, "verdict": row["verdict"]}


# ---- the report

TEXT = KindText("comparison")

_COMPARED = {"ahead": "worse than", "behind": "better than", "tie": "no significant difference from"}
"""How the reference compares with the candidates of each verdict."""


def describe(result: Run) -> dict[str, Any]:
    """Return what the text prints."""
    rows = [{**row, "name": candidate_name(row["method"])} for row in to_records(result.frames["comparison"])]
    own = next(row for row in rows if row["verdict"] == REFERENCE)
    others = [row for row in rows if row["verdict"] != REFERENCE]
    ranked = {key: [row for row in others if row["verdict"] == key] for key in (BEHIND, TIE, AHEAD)}
    laws = {row["verdict"] for row in others if row["method"] in LAWS}
    floors = {one.name: own[f"floor_{one.name}"] for one in headline_metrics() if one.has_floor}
    differences = result.frames["differences"]
    return {
        "own": own,
        "name": own["name"][:1].upper() + own["name"][1:],
        "rows": [own, *others],
        "compared": [
            {"words": words, "names": [row["name"] for row in ranked[key]]}
            for key, words in _COMPARED.items()
            if ranked[key]
        ],
        "ranked": {
            key: [f"{row['name']} ({_format_difference(row)})" for row in found]
            for key, found in ranked.items()
            if found
        },
        "law_verdicts": sorted(laws) if own["method"] == "ogden" else [],
        "repeats": differences["group"].nunique() < differences["insertion"].nunique(),
        "folds": result.record.folds,
        "metrics": [one.label for one in headline_metrics()],
        "floors": join_metrics(floors, 3),
        "max_k": f"{importance.MAX_PARETO_K}",
    }


def judge(result: Run) -> list[Verdict]:
    """Return how the reference predicts held-out needles beside every other candidate."""
    found = describe(result)
    numbers = {key: found["own"][key] for key in ("te_mm", "floor_te_mm", "insertions")}
    sentence = TEXT.sentence("verdict", found).rstrip(".")
    return [Verdict(sentence, "warn" if AHEAD in found["ranked"] else "pass", "", numbers)]


def _format_difference(row: Row) -> str:
    if row["difference"] is None:
        return "no density"
    digits = 1 if abs(row["difference"]) < 1000 else 0
    return f"{row['difference']:+z.{digits}f} ± {row['difference_se']:.{digits}f}".replace("-", "−")


def tabulate(result: Run) -> list[Table]:
    """Return a table with one row for each candidate."""
    errors = (metric.name for metric in headline_metrics())
    columns = ("method", "density_difference", "verdict", "draws_se", *errors, "noise_scale", "pareto_k")
    rows = [
        {
            **row,
            "method": candidate_name(row["method"]),
            "reference": row["verdict"] == REFERENCE,
            "density_difference": "0" if row["verdict"] == REFERENCE else _format_difference(row),
            DIGITS: 3,
        }
        for row in to_records(result.frames["comparison"])
    ]
    return [Table("comparison", rows, columns, strong="reference")]


def draw(result: Run) -> dict[str, Drawing]:
    """Return the differences of each group, and their mean with two standard errors."""
    held_out = "group of repeats" if describe(result)["repeats"] else "needle"
    frame = result.frames["group_differences"].assign(held_out=held_out, origin=result.origin)
    mean: dict[str, Any] = {"marker": "D", "size": 5.0}
    looks = {
        "each": Look(f"each {held_out}", GREY, shift=0.2, size=2.5),
        AHEAD: Look(f"mean, {AHEAD}", GREEN, **mean),
        TIE: Look(f"mean, {TIE}", GREY, **mean),
        BEHIND: Look(f"mean, {BEHIND}", METHOD_COLOURS["hand_tuned"], **mean),
    }
    options = {
        **{"rows": ["method"], "value": "difference", "by": "look", "looks": looks},
        **{"name_row": lambda row: candidate_name(row[0]), "intervals": [("low", "high")]},
        "x_label": "log predictive density minus that of the reference (symmetric logarithm)",
        **{"scale": 1.0, "zero": True, "row_height": 0.36},
    }

    def choose_look(every: pd.DataFrame) -> pd.DataFrame:
        return every.assign(look=every["verdict"].where(every["group"] == "mean", "each"))

    return {"group_differences": Drawing("dots_with_intervals", frame, options, choose_look)}


REPORT = StudyReport(
    TEXT,
    describe,
    tabulate,
    draw,
    judge=judge,
    headline=lambda fault: (
        "CONTROL NOT DETECTED" if "is not found ahead of" in fault else headline_fault(fault)
    ),
)
