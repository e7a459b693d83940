"""Check by simulation that the computed uncertainty is right if the model is.

Truths are parameters from the prior, which is simulation-based calibration, or those of another model.
S. Talts, M. Betancourt, D. Simpson, A. Vehtari, A. Gelman, arXiv 1804.06788; the log likelihood among what is
ranked is from M. Modrak et al., Bayesian Anal. 20 (2025) 461.

The other model is that of the synthetic dataset (`needlefit.synthetic.design`), which each replicate draws
anew. It fits the insertions of the study, and ranks true values and measured held-out tips.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np
import pandas as pd
from pydantic import Field

from needlefit.arrays import Floats
from needlefit.datasets.read import read
from needlefit.errors import ConfigError, FitError, ModelError
from needlefit.grouping import group_values
from needlefit.inference import rank_statistics
from needlefit.inference.forward_model import PreparedModel
from needlefit.inference.identifiability.precision import linearize
from needlefit.inference.identifiability.profile import minimize_squares
from needlefit.inference.likelihood.observations import OBSERVATIONS
from needlefit.inference.optimize import minimize
from needlefit.inference.parameter_names import NOISE_SCALE
from needlefit.inference.predict import Draws, draw_from_prior, thin_posterior
from needlefit.inference.problem import Problem
from needlefit.inference.rank_statistics import RANK_DRAWS, Counts, place_pit
from needlefit.inference.sampling import importance
from needlefit.inference.sampling.sample import sample
from needlefit.project.checkpoint import open_checkpoint
from needlefit.project.random_streams import random_stream
from needlefit.project.toml import locate_key
from needlefit.reporting.figures import Drawing
from needlefit.reporting.number_format import format_bare_symbol, insert_symbols
from needlefit.reporting.table import Table, part, pivot
from needlefit.reporting.table_files import to_records
from needlefit.reporting.text import KindText
from needlefit.schemas.analyses import TargetRecord
from needlefit.schemas.limits import DEFAULT_REPLICATES, MAX_REPLICATES
from needlefit.schemas.recipe import RecipeRecord
from needlefit.schemas.run_metadata import CalibrationMetadata
from needlefit.studies.advice import advise
from needlefit.studies.answer import Advice, Answer, FaultKind, RunFault, Status
from needlefit.studies.fold_draws import Specimens
from needlefit.studies.held_out_predictions import predict_held_out
from needlefit.studies.job import Inputs, Job, Settings
from needlefit.studies.kind import StudyKind
from needlefit.studies.load import load_study
from needlefit.studies.report import StudyReport, answer_in_words
from needlefit.studies.run import Run
from needlefit.studies.runner import FrameRows, join_rows, run_tasks
from needlefit.studies.score import Row
from needlefit.studies.simulated_data import (
    choose_reference_values,
    draw_bevels,
    find_true_value,
    simulate_design,
    simulate_measurement,
)
from needlefit.studies.study_files import begin_run, prepare_target, prepare_with_held_out, target_name
from needlefit.synthetic.build import build_dataset
from needlefit.synthetic.design import POPULATION, InsertionDesign, draw_specimen, list_designs

HELD_OUT_TIP = "held_out_tip"  #: all held-out tips of a synthetic truth
DESIGN, FIT, TIP, LIKELIHOOD = "stiff_design", "stiff_fit", "tip_mm", "log_likelihood"
"""Beside the parameters: the combination that the design determines best, the one that the data determine
best at the fitted values, the tip of the deepest insertion, and the log likelihood, without which the prior
itself would pass for a posterior."""

_QUANTITY_NAMES = {
    HELD_OUT_TIP: "held-out tips",
    DESIGN: "stiffest, of the design",
    FIT: "stiffest, at the fit",
    TIP: "tip of the deepest",
    LIKELIHOOD: "log likelihood",
}


def name_quantity(name: str) -> str:
    return _QUANTITY_NAMES.get(name, format_bare_symbol(name))


RANK_PREFIX = "rank_"  #: of the columns of ranks in the frame `replicates`
#: name of the dataset whose insertions `design_synthetic` knows
SYNTHETIC_DATASET = "twin"
PRINTED_LEVELS = (0.50, 0.95)  #: central intervals whose coverage is printed


class CalibrationRecord(TargetRecord):
    """`kind = "calibration"`: are the uncertainties calibrated? Ranks of true parameters in posteriors."""

    kind: Literal["calibration"]
    replicates: int = Field(default=DEFAULT_REPLICATES, ge=1, le=MAX_REPLICATES)
    """Simulated datasets."""
    truth: Literal["prior", "synthetic"] = "prior"
    """True parameters from the prior, or synthetic datasets of a model that is not the fitted one."""


KIND = StudyKind("calibration", CalibrationRecord, __name__, CalibrationMetadata)
"""What `needlefit calibrate` runs, or a study file."""

FRAMES: Mapping[str, tuple[str, ...]] = {
    # a row per quantity and level; `low`, `high`: 95 % interval of the share
    "coverage": (
        *("quantity", "level", "replicates", "covered", "expected", "count_low", "count_high", "passes"),
        *("share", "low", "high"),
    ),
}


# ---- a posterior, and what is ranked in it


def infer_posterior(
    problem: Problem, recipe: RecipeRecord, count: int, rng: np.random.Generator
) -> tuple[Draws, Floats]:
    """Return draws of the posterior of a problem, and its mode (P,); no start of the search uses the truth.

    Draws are by importance sampling, and by MCMC from these where their weights are not certified.
    """
    searched = recipe.model_copy(update={"minimize": "posterior"})
    fit = minimize(problem, searched, rng)
    problem = problem.holding(fit.held)
    ends = importance.find_modes(fit, problem.upper - problem.lower)
    rng.integers(1, 2**31, size=recipe.starts)  # not used: with it a seed gives the stored replicates
    modes = [minimize_squares(problem.searched, end) for end in problem.parameters.restrict(ends)]
    found = importance.sample_about_modes(problem, modes, rng)
    posterior = None if found.certified else sample(problem, found, recipe.sample, rng)
    if posterior is None:
        return importance.resample_draws(found, count, rng), ends[0]
    return thin_posterior(posterior, problem.parameters, count, found.k), ends[0]


def compute_ranked(problem: Problem, directions: Floats, thetas: Floats) -> dict[str, Floats]:
    """Return the ranked functions (N,) of thetas (N, P) under one problem, by name.

    `directions` (2, P) are unit vectors of `DESIGN` and `FIT`, which a single parameter has not.
    """
    sets = [problem.values(theta) for theta in thetas]
    found = dict(zip(problem.names, thetas.T, strict=True))
    if thetas.shape[1] > 1:
        found |= {DESIGN: thetas @ directions[0], FIT: thetas @ directions[1]}
    tip = max(problem.insertions, key=lambda one: one.depth)
    (tips,) = PreparedModel(problem.medium, [tip]).read_points(sets, [np.array([tip.depth])])
    prior = [problem.parameters.prior.log_density(values) for values in sets]
    return {**found, TIP: tips[:, 0, 1], LIKELIHOOD: problem.log_posteriors(thetas) - prior}


def best_determined_direction(problem: Problem, theta: Floats) -> Floats:
    """Return the combination (P,), of length 1, that the insertions determine best at theta."""
    slope = linearize(problem, theta).slope
    vector: Floats = np.linalg.svd(slope, full_matrices=False)[2][0]
    return vector * np.sign(vector[np.argmax(np.abs(vector))])


# ---- replicates whose truths are drawn from the prior

MAX_PRIOR_DRAWS = 1000  #: draws of the prior among which one must have a solution


def find_stiff_direction(job: Job) -> dict[str, float]:
    """Return weights, by name, of the combination that the design of the insertions determines best.

    Raises ConfigError if the dataset states no noise, or holds tip tracks; FitError if the planned insertions
    have no solution where they are looked at.
    """
    if not job.dataset.noise.stated:
        raise ConfigError(
            f"the dataset `{job.dataset.name}` states no noise: nothing can be drawn from it",
            where=locate_key(job.dataset.path, "noise.point_sd_mm"),
            expected="[noise] with point_sd_mm or correlated_sd_mm above 0",
        )
    if any(OBSERVATIONS[one.observed].on_the_way for one in job.insertions):
        raise ConfigError(
            f"the dataset `{job.dataset.name}` holds tip tracks, which are not simulated",
            expected="measured shapes",
        )
    (fold,) = job.folds
    values, place = choose_reference_values(job)
    design = simulate_design(job, fold, values)
    if design is None:
        raise FitError(
            f"the planned insertions have no solution at {place}", fix="name a set of the paper's parameters"
        )
    stiff = best_determined_direction(design, design.parameters.theta(values))
    return dict(zip(design.names, stiff.tolist(), strict=True))


def replicate(number: int, job: Job, stiff: Mapping[str, float]) -> FrameRows:
    """Return a row of `replicates`: the truth, its ranks in its posterior, and how that was computed.

    `stiff` is from `find_stiff_direction`.
    """
    stream = partial(random_stream, job.recipe.seed, job.name, "calibrate", number)
    drawn, problem = simulate_experiment(job, stream("data"))
    truth, rng = problem.values(drawn), stream("inference")
    found, mode = infer_posterior(problem, job.recipe, RANK_DRAWS, rng)
    design = np.array([stiff[name] for name in problem.names])
    directions = np.array([design, best_determined_direction(problem, mode)])
    true = compute_ranked(problem, directions, problem.parameters.theta(truth)[None])
    inferred = compute_ranked(problem, directions, found.thetas)
    placed = rank_statistics.rank_truth(
        np.concatenate([*true.values()]), np.column_stack([*inferred.values()]), rng
    )
    row = {
        "replicate": number,
        **{name: truth[name] for name in problem.names},
        **found.describe(),
        **{f"{RANK_PREFIX}{name}": int(rank) for name, rank in zip(true, placed, strict=True)},
    }
    return {"replicates": [row]}


def simulate_experiment(job: Job, rng: np.random.Generator) -> tuple[Floats, Problem]:
    """Return parameters (P,) drawn from the prior, and the problem of inferring them from simulated needles.

    Raises FitError if the prior hardly holds parameters that the design has a solution for.
    """
    (fold,) = job.folds
    everything = job.problem(fold)
    for _ in range(MAX_PRIOR_DRAWS):
        theta = draw_from_prior(job.parameters, 1, rng)[0]
        values = everything.values(theta)
        design = simulate_design(job, fold, values)
        if design is None:
            continue
        true = {NOISE_SCALE: everything.density.scale, **values}
        shared = draw_bevels(job.dataset, design.insertions, rng) if everything.bevels_differ else {}
        made = [
            simulate_measurement(job.dataset, one, true, job.medium, rng, shared) for one in design.insertions
        ]
        known = tuple(one for one in made if one is not None)
        if len(known) < len(made):
            continue
        problem = replace(everything, insertions=known)
        if np.isfinite(problem.log_posterior(theta)):
            return theta, problem
    raise FitError(
        f"of {MAX_PRIOR_DRAWS} parameter sets drawn from the prior the design has a solution for none",
        fix="narrow the bounds of the medium",
    )


# ---- replicates whose truths are those of another model

PREDICTION_DRAWS = 13 * (RANK_DRAWS + 1) - 1
"""Draws of each posterior, 1039: among them the truth has 13 places for each place of a rank."""

MAX_TWIN_SEEDS = 100  #: seeds of a replicate among which one must have a solution


def design_synthetic(job: Job) -> tuple[InsertionDesign, ...]:
    """Return what each replicate simulates; ConfigError for several folds, or insertions not synthetic."""
    if len(job.folds) > 1:
        raise ConfigError(
            f"`{job.name}` has {len(job.folds)} folds: a synthetic truth is fitted once",
            expected="a study with [tune] and [[validate]], or a fit",
        )
    wanted = {one.id for one in job.insertions}
    chosen = tuple(one for one in list_designs() if one.id in wanted)
    unknown = sorted(wanted - {one.id for one in chosen})
    if unknown:
        raise ConfigError(
            f"insertion {unknown[0]} of dataset `{job.dataset.name}` is none of the synthetic dataset",
            expected="a study or fit on the dataset `twin`: others have no synthetic truth",
        )
    return chosen


def replicate_synthetic(number: int, study: Job, designs: Sequence[InsertionDesign]) -> FrameRows:
    """Return a row of `replicates` with the ranks of true values and of held-out tips, and rows of these.

    `study` is the one whose insertions, `designs`, are simulated anew.
    """
    job, seed = _draw_study(number, study, designs)
    (fold,) = job.folds
    rng = random_stream(job.recipe.seed, job.name, "inference")
    problem = job.problem(fold)
    found, _ = infer_posterior(problem, job.recipe, PREDICTION_DRAWS, rng)
    sets, parameters = [job.parameters.values(theta) for theta in found.thetas], list[Row]()
    for name in job.parameters.free:
        truth = find_true_value(problem, name, seed, POPULATION)
        values = np.array([one[name] for one in sets])
        if np.isfinite(truth):
            low, middle, high = np.percentile(values, [2.5, 50.0, 97.5]).tolist()
            row = {"parameter": name, "truth": truth, "value": middle}
            row |= {"interval_low": low, "interval_high": high}
            # the middle of the truth's place
            parameters.append({**row, "pit": (int(np.sum(values < truth)) + 0.5) / (len(values) + 1)})
    predictions = [one.row for one in predict_held_out(Specimens(job, fold, found))]
    pits = {one["insertion"]: one["tip_pit"] for one in predictions}
    tips = {}
    for one in fold.validate:
        pit = pits.get(one.id)  # of less toward +y; the truth of what cannot be predicted lies outside
        tips[one.id] = place_pit(0.0 if pit is None else pit if one.side > 0 else 1 - pit)
    row = {
        "replicate": number,
        "seed": seed,
        **found.describe(),
        **{f"{RANK_PREFIX}{HELD_OUT_TIP}:{name}": rank for name, rank in tips.items()},
        **{f"{RANK_PREFIX}{one['parameter']}": place_pit(one["pit"]) for one in parameters},
    }
    every = {"replicates": [row], "parameters": parameters, "predictions": predictions}
    return {name: [{"replicate": number, **one} for one in rows] for name, rows in every.items()}


def _draw_study(number: int, job: Job, designs: Sequence[InsertionDesign]) -> tuple[Job, int]:
    """Return the study on the data of a replicate, and their seed."""
    for attempt in range(MAX_TWIN_SEEDS):
        rng = random_stream(job.recipe.seed, job.name, "calibrate", number, "twin", attempt)
        seed = int(rng.integers(2**31))
        if not is_inside_bounds(seed, job.parameters.bounds, designs):
            continue
        try:
            with TemporaryDirectory() as folder:
                dataset = read(build_dataset(Path(folder), seed, designs, population=POPULATION))
        except ModelError:  # a needle that does not settle
            continue
        # the name keys the random numbers of predictions, which no two replicates share
        settings = Settings(seed=job.recipe.seed, inputs=Inputs(medium=job.medium, recipe=job.recipe))
        return load_study(f"{job.name} {number}", job.record, settings, dataset), seed
    raise ModelError(
        f"of {MAX_TWIN_SEEDS} synthetic datasets none has a solution for every insertion",
        fix="select other insertions, or widen the bounds of the medium",
    )


def is_inside_bounds(
    seed: int, bounds: Mapping[str, tuple[float, float]], designs: Iterable[InsertionDesign]
) -> bool:
    """Return whether moduli (Pa) and bevel offsets (mm) of all specimens lie inside the bounds, by name."""
    for medium, name in {(one.medium, one.specimen) for one in designs}:
        specimen = draw_specimen(seed, medium, name, POPULATION)
        values = {f"mu{n}_pa": 1e6 * mu for n, mu in enumerate(specimen.mu.tolist(), start=1)}
        values["bevel_mm"] = specimen.bevel
        if any(not low <= values.get(one, low) <= high for one, (low, high) in bounds.items()):
            return False
    return True


# ---- the run


def run(name: str, record: CalibrationRecord, settings: Settings) -> Run:
    """Rank the truth in its posterior for `record.replicates` random insertions.

    Raises ConfigError if nothing is free, or as `find_stiff_direction` and `design_synthetic`.
    """
    target = target_name(record, settings).removesuffix("-tune")
    synthetic = record.truth == "synthetic"
    job = (prepare_with_held_out if synthetic else prepare_target)(record, target, settings)
    if not job.parameters.searched.free:
        raise ConfigError(f"nothing of medium `{job.record.medium}` is free: there is nothing to infer")
    if synthetic:
        task = partial(replicate_synthetic, study=job, designs=design_synthetic(job))
        planned: Row = {"draws": PREDICTION_DRAWS}
    else:
        stiff = find_stiff_direction(job)
        task, planned = partial(replicate, job=job, stiff=stiff), {"draws": RANK_DRAWS, "stiff_design": stiff}
    about = begin_run(name, record, job, f"Calibration: {job.record.title or target}")
    work = about.metadata.extend(CalibrationMetadata, **planned)
    checkpoint = open_checkpoint(settings.checkpoint, settings.resume, work.work, settings.note)
    tasks = {f"replicate {number}": partial(task, number) for number in range(record.replicates)}
    parts = run_tasks(tasks, job.name, settings, checkpoint)
    frames = _make_frames(join_rows(parts), synthetic)
    outcome = judge_ranks(frames) if parts else {}
    return replace(
        about,
        frames=frames,
        origin="synthetic" if synthetic else about.origin,
        metadata=work.state(**outcome),
        interrupted=len(parts) < record.replicates,
        faults=tuple(list_faults(outcome)) if parts else (),
    )


def _make_frames(rows: FrameRows, synthetic: bool) -> dict[str, pd.DataFrame]:
    """Return the frames of replicates: a row per replicate, coverage, and ECDFs of the ranks."""
    replicates = pd.DataFrame(rows.get("replicates", []))
    ranked = [str(one) for one in replicates.columns if one.startswith(RANK_PREFIX)]
    # of several, `<quantity>:<which>`
    columns = group_values((one.removeprefix(RANK_PREFIX).partition(":")[0], one) for one in ranked)
    ranks: dict[str, Counts] = {
        name: replicates[each[0] if len(each) == 1 else each].to_numpy(dtype=np.int64)
        for name, each in columns.items()
    }
    coverage, ecdfs = rank_statistics.tabulate_covered_shares(ranks), pd.DataFrame()
    if ranks:
        ecdfs = rank_statistics.tabulate_ecdfs(ranks)
        ecdfs["calibrated"] = ~ecdfs["quantity"].isin(rank_statistics.find_failing(coverage, ecdfs))
    frames = {"replicates": replicates, "coverage": coverage, "ranks": ecdfs}
    if synthetic and rows:
        frames |= {name: pd.DataFrame(rows[name]) for name in ("parameters", "predictions")}
        if len(frames["predictions"]):
            frames["tips"] = average_tips(frames["predictions"])
    return frames


def average_tips(predictions: pd.DataFrame) -> pd.DataFrame:
    """Return a row per replicate: its number of held-out needles, and means of their intervals and scores."""
    ends = [f"tip_{level}_{end}_mm" for level in ("50", "95") for end in ("low", "high")]
    scores = [f"{what}_in_{level}" for what in ("tip", "points", "shape") for level in ("50", "95")]
    scores += ["tip_crps_mm", "tip_interval_score_mm"]
    groups = predictions[["replicate", *ends, *scores]].astype(float).groupby("replicate")
    means = groups.mean()
    means.insert(0, "insertions", groups.size())
    return means.reset_index().astype({"replicate": int})


def judge_ranks(frames: Mapping[str, pd.DataFrame]) -> dict[str, Any]:
    """Return the outcome: it passes if all quantities are calibrated."""
    replicates, coverage = frames["replicates"], frames["coverage"]
    failing = rank_statistics.find_failing(coverage, frames["ranks"])
    half = coverage[coverage["level"] == min(coverage["level"])]
    outcome = {
        "replicates": len(replicates),
        "passes": not failing,
        "conclusive": bool((half["count_low"] > 0).all()),
        "not_calibrated": failing,
        "untrusted": int((~replicates["certified"].astype(bool)).sum()),
    }
    if "predictions" in frames:  # there is none where too few draws had a solution
        asked = sum(str(name).startswith(f"{RANK_PREFIX}{HELD_OUT_TIP}:") for name in replicates)
        outcome["not_predicted"] = asked * len(replicates) - len(frames["predictions"])
    return outcome


def list_faults(outcome: Mapping[str, Any]) -> Iterator[RunFault]:
    """Yield what makes the outcome doubtful beside what the verdict states."""
    if outcome["untrusted"]:
        yield RunFault(FaultKind.NOT_CONVERGED, f"{outcome['untrusted']} posteriors have not converged")
    if outcome.get("not_predicted"):
        what = f"{outcome['not_predicted']} held-out insertions could not be predicted"
        yield RunFault(FaultKind.INCOMPLETE, what)


# ---- the report

#: which sentences are printed, by what was found
RULES: Mapping[str, Callable[[Any], object]] = {
    "fails": lambda v: v.failing,
    "tips_covered": lambda v: v.tips and not v.failing,
    "undecided": lambda v: not (v.failing or v.tips or v.conclusive),
    "calibrated": lambda v: v.conclusive and not (v.failing or v.tips),
    **dict.fromkeys(("shared_by_tips", "by_pit", "tests_model"), lambda v: v.synthetic),
    **dict.fromkeys(("stiffest", "tests_computation"), lambda v: not v.synthetic),
}
TEXT = KindText("calibration", rules=RULES)


def describe_calibration(run: Run) -> dict[str, Any]:
    """Return what the text prints."""
    coverage = to_records(run.frames["coverage"])
    quantities = run.frames["coverage"]["quantity"].nunique()
    stated, study = run.knows(CalibrationMetadata), run.record
    return {
        "replicates": stated.replicates,
        "conclusive": stated.conclusive,
        "synthetic": study.truth == "synthetic",
        "tips": {f"{100 * one['level']:.0f}": one for one in coverage if one["quantity"] == HELD_OUT_TIP},
        "failing": [insert_symbols(name_quantity(name)) for name in stated.not_calibrated],
        "quantities": quantities,
        "target": study.target,
        "draws": RANK_DRAWS,
        "family_error": rank_statistics.FAMILY_ERROR,
        "single_error": f"{rank_statistics.single_check_error(quantities):.1e}",
    }


def tabulate_calibration(run: Run) -> list[Table]:
    """Return a row per quantity: the share of true values in central intervals, and ranks beyond chance."""
    outside = run.frames["ranks"].query("not passes").groupby("quantity").size()
    stated = run.knows(CalibrationMetadata)
    calibrated = "yes" if stated.conclusive else "undecided"
    rows = [
        {
            **row,
            "ranks": f"{outside.get(row['quantity'], 0)} of {RANK_DRAWS} outside",
            "calibrated": "NO" if row["quantity"] in stated.not_calibrated else calibrated,
            "quantity": name_quantity(row["quantity"]),
        }
        for row in to_records(run.frames["coverage"])
    ]
    levels = (part("covered_share", level=one) for one in PRINTED_LEVELS)
    columns = ("quantity", *levels, "ranks", "calibrated")
    return [Table("calibration", pivot(rows, ["quantity"], ["level"]), columns)]


def draw_calibration(run: Run) -> dict[str, Drawing]:
    """Return, for each quantity, the ECDF of the ranks minus that of uniform ranks, on the band by chance.

    A curve that is first above and then below: posteriors too narrow; the other way round: too wide.
    """

    def center_ecdfs(ranks: pd.DataFrame) -> pd.DataFrame:
        x = ranks["rank"] / (RANK_DRAWS + 1)
        count = ranks["expected"] / x
        ends = {name: ranks[key] / count - x for name, key in (("low", "count_low"), ("high", "count_high"))}
        names = ranks["quantity"].map(name_quantity)
        about = {"x": x, "y": ranks["below"] / count - x, "inside": ranks["passes"]}
        return ranks.assign(panel=names, **ends, **about, passes=ranks["calibrated"])

    frame = run.frames["ranks"].assign(origin=run.origin)
    options = {"x_label": "rank of the truth", "y_label": "ECDF − uniform"}
    return {"ranks": Drawing("steps_in_bands", frame, options, center_ecdfs)}


def answer_calibration(run: Run) -> Answer:
    """Return whether the uncertainties are correct."""
    stated = run.knows(CalibrationMetadata)
    status: Status = "pass" if stated.passes else "fail"
    numbers: dict[str, float | str | None] = {
        "replicates": stated.replicates,
        "not_calibrated": ", ".join(stated.not_calibrated),
    }
    answer = answer_in_words(run, status if stated.conclusive else "warn", **numbers)
    return replace(answer, advice=_advise_on_truths(run))


def _advise_on_truths(run: Run) -> Advice | None:
    """Return what to do: more truths, or a test of the model, which the synthetic dataset allows."""
    stated, synthetic = run.knows(CalibrationMetadata), run.record.truth == "synthetic"
    if not stated.conclusive:
        finding = ["synthetic_truths_too_few" if synthetic else "truths_too_few"]
    elif not stated.passes:
        finding = ["not_calibrated"]
    else:
        has_synthetic = stated.dataset.name == SYNTHETIC_DATASET and len(stated.folds) == 1
        finding = [] if synthetic else ["computation_calibrated" if has_synthetic else "prior_calibrated"]
    return advise(finding, {"target": run.record.target, "replicates": DEFAULT_REPLICATES})


REPORT = StudyReport(TEXT, describe_calibration, tabulate_calibration, draw_calibration, answer_calibration)
