"""Run a calibration: draw truths, simulate, infer, and rank each truth in what was inferred.

Truths are parameters from the prior, which is simulation-based calibration, or another model's.
S. Talts, M. Betancourt, D. Simpson, A. Vehtari, A. Gelman, arXiv 1804.06788; the log likelihood among what is
ranked is from M. Modrak et al., Bayesian Anal. 20 (2025) 461.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from needlefit.datasets.insertion import Insertion
from needlefit.errors import ConfigError, FitError
from needlefit.project.toml_lines import locate_key
from needlefit.studies.checkpoint import open_checkpoint
from needlefit.studies.folds import Fold
from needlefit.studies.job import Job, Settings
from needlefit.studies.kinds.calibration.quantities import best_determined_direction
from needlefit.studies.kinds.calibration.replicate import Experiment, replicate
from needlefit.studies.kinds.calibration.schema import CalibrationRecord
from needlefit.studies.kinds.calibration.synthetic_truth import (
    HELD_OUT_TIP,
    PREDICTION_DRAWS,
    prepare_synthetic,
    replicate_synthetic,
)
from needlefit.studies.planned_insertions import choose_reference_values, simulate_design
from needlefit.studies.proportions import wilson_interval
from needlefit.studies.rank_statistics import (
    RANK_DRAWS,
    Counts,
    find_failing,
    tabulate_coverage,
    tabulate_ecdfs,
)
from needlefit.studies.run import Run
from needlefit.studies.score import Row
from needlefit.studies.targets import begin_run, prepare_target, prepare_with_held_out, target_name

CHECKPOINT_ROWS = "replicates"
RANK_PREFIX = "rank_"

NESTED_FRAMES = ("parameters", "predictions")
"""Frames of synthetic truths: each replicate's rows, which its checkpoint keeps with it."""

Task = Callable[[int], dict[str, Any]]
"""Makes the row of a replicate, given its number."""

MAX_SAMPLED_INSERTIONS = 3
"""Insertions of the design whose posteriors the sampler draws: the shallowest, the middle and the deepest."""


def run(name: str, record: CalibrationRecord, settings: Settings) -> Run:
    """Rank the truth in its posterior for `record.replicates` random insertions.

    Raises
    ------
    ConfigError, DataError
        If anything the record names is missing or wrong, or no noise is stated.
    FitError
        If the design has no solution where it is looked at, or nowhere in the prior.
    """
    target = target_name(record, settings).removesuffix("-tune")
    if record.truth == "synthetic":
        job = prepare_with_held_out(record, target, settings)
        synthetic = prepare_synthetic(job, record.ct)
        task: Task = partial(replicate_synthetic, experiment=synthetic)
        work: dict[str, Any] = {"draws": PREDICTION_DRAWS}
    else:
        prepared = prepare_target(record, target, replace(settings, sample=record.sampled))
        experiment = _prepare_experiment(prepared, record)
        job, task = experiment.job, partial(replicate, experiment=experiment)
        work = {"draws": RANK_DRAWS, "stiff_design": dict(experiment.stiff)}
    about = begin_run(name, record, job, f"Calibration: {job.record.title or target}")
    work = {**about.run, **work}
    rows, interrupted = _run_replicates(task, job, record.replicates, work, settings)
    (fold,) = job.folds
    design = pd.DataFrame({"insertion": [i.id for i in fold.tune], "depth_mm": [i.depth for i in fold.tune]})
    frames = {"design": design, **_split_rows(rows)}
    if record.truth == "synthetic" and rows:
        frames["coverage"] = add_intervals(frames["coverage"])
        if len(frames["predictions"]):
            frames["tips"] = average_tips(frames["predictions"])
    outcome = judge_ranks(frames, record.control) if rows else {}
    return replace(
        about,
        frames=frames,
        origin="synthetic" if record.truth == "synthetic" else about.origin,
        run={**work, **outcome},
        interrupted=interrupted,
        faults=tuple(find_calibration_faults(outcome)) if rows else (),
    )


def _run_replicates(
    task: Task, job: Job, count: int, work: Mapping[str, Any], settings: Settings
) -> tuple[list[Row], bool]:
    """Return the rows of all replicates, and whether a stop left some of them undone."""
    checkpoint = open_checkpoint(settings.checkpoint, settings.resume, work, settings.note)
    known = {
        row["replicate"]: row
        for row in checkpoint.rows(CHECKPOINT_ROWS, ("replicate",))
        if row["replicate"] < count
    }
    left = [number for number in range(count) if number not in known]
    label = f"{job.name}: replicates"
    settings.progress(label, len(known), count)
    for _, row in settings.task_pool().run(task, left, settings.stop):
        known[row["replicate"]] = row
        checkpoint.keep_row(CHECKPOINT_ROWS, row)
        settings.progress(label, len(known), count)
    return [known[number] for number in sorted(known)], len(known) < count


def _split_rows(rows: Sequence[Row]) -> dict[str, pd.DataFrame]:
    """Return the frames of replicates; the nested rows of synthetic truths are frames of their own."""
    plain = [{key: value for key, value in row.items() if key not in NESTED_FRAMES} for row in rows]
    nested = {
        frame: pd.DataFrame([{"replicate": row["replicate"], **one} for row in rows for one in row[frame]])
        for frame in NESTED_FRAMES
        if rows and frame in rows[0]
    }
    return {**tabulate_ranks(pd.DataFrame(plain)), **nested}


def average_tips(predictions: pd.DataFrame) -> pd.DataFrame:
    """Return a row per replicate: its number of held-out tips, and means of their intervals and scores."""
    ends = [f"tip_{level}_{end}_mm" for level in ("50", "95") for end in ("low", "high")]
    scores = ["tip_in_50", "tip_in_95", "tip_crps_mm", "tip_interval_score_mm"]
    columns = predictions[["replicate", *ends, *scores]]
    groups = columns.astype(float).groupby("replicate")
    means = groups.mean()
    means.insert(0, "insertions", groups.size())
    return means.reset_index().astype({"replicate": int})


def add_intervals(coverage: pd.DataFrame) -> pd.DataFrame:
    """Return the coverage with the share covered and its 95 % binomial interval (Wilson's)."""
    share = coverage["covered"] / coverage["replicates"]
    ends = [wilson_interval(*pair) for pair in zip(share, coverage["replicates"], strict=True)]
    low, high = np.array(ends).reshape(-1, 2).T
    return coverage.assign(share=share, low=low, high=high)


def _prepare_experiment(job: Job, record: CalibrationRecord) -> Experiment:
    """Return what is repeated.

    Raises
    ------
    ConfigError
        If the dataset states no noise, or nothing is free.
    """
    if not job.dataset.noise.stated:
        raise ConfigError(
            f"the dataset `{job.dataset.name}` states no noise: nothing can be drawn from it",
            where=locate_key(job.dataset.path, "noise.point_sd_mm"),
            expected="[noise] with point_sd_mm or correlated_sd_mm above 0",
        )
    if not job.parameters.free:
        raise ConfigError(f"nothing of medium `{job.record.medium}` is free: there is nothing to infer")
    fold = job.folds[0]
    if record.sampled:
        fold = Fold(fold.name, _select_few(fold.tune), ())
    return Experiment(replace(job, folds=(fold,)), weigh_design(job, fold), record.sampled, record.control)


def weigh_design(job: Job, fold: Fold) -> dict[str, float]:
    """Return the weights, by parameter, of the combination that the planned insertions determine best.

    Raises
    ------
    FitError
        If these have no solution where they are looked at.
    """
    values, place = choose_reference_values(job)
    design = simulate_design(job, fold, values)
    if design is None:
        raise FitError(
            f"the planned insertions have no solution at {place}", fix="name a set of the paper's parameters"
        )
    stiff = best_determined_direction(design, design.parameters.theta(values))
    return dict(zip(design.names, stiff.tolist(), strict=True))


def _select_few(insertions: tuple[Insertion, ...]) -> tuple[Insertion, ...]:
    by_depth = sorted(insertions, key=lambda one: one.depth)
    if len(by_depth) <= MAX_SAMPLED_INSERTIONS:
        return insertions
    return tuple(by_depth[k] for k in (0, len(by_depth) // 2, -1))


def tabulate_ranks(replicates: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Return the frames of replicates: a row per replicate, coverage, and ECDFs of the ranks."""
    ranks = _collect_ranks(replicates)
    coverage, ecdfs = tabulate_coverage(ranks), pd.DataFrame()
    if ranks:
        ecdfs = tabulate_ecdfs(ranks)
        ecdfs["calibrated"] = ~ecdfs["quantity"].isin(find_failing(coverage, ecdfs))
    return {"replicates": replicates, "coverage": coverage, "ranks": ecdfs}


def _collect_ranks(replicates: pd.DataFrame) -> dict[str, Counts]:
    """Return the ranks (N,) of every quantity; (N, K) of one with K columns, `rank_<quantity>:<which>`."""
    columns: dict[str, list[str]] = {}
    for column in replicates.columns:
        if column.startswith(RANK_PREFIX):
            columns.setdefault(column.removeprefix(RANK_PREFIX).partition(":")[0], []).append(column)
    found = {name: replicates[each].to_numpy(dtype=np.int64) for name, each in columns.items()}
    return {name: ranks[:, 0] if ranks.shape[1] == 1 else ranks for name, ranks in found.items()}


def judge_ranks(frames: Mapping[str, pd.DataFrame], control: str | None) -> dict[str, Any]:
    """Return the outcome. It passes if it is calibrated, or not if the likelihood is wrong on purpose."""
    replicates, coverage = frames["replicates"], frames["coverage"]
    failing = find_failing(coverage, frames["ranks"])
    half = coverage[coverage["level"] == min(coverage["level"])]
    return {
        "replicates": len(replicates),
        "control": control,
        "passes": bool(failing) == (control is not None),
        "conclusive": bool((half["count_low"] > 0).all()),
        "not_calibrated": failing,
        "draw_source": replicates["draw_source"].value_counts().to_dict(),
        "untrusted": int((~replicates["certified"].astype(bool)).sum()),
        "redrawn": int(replicates["redrawn"].sum()),
        **({"not_predicted": _count_missing(frames)} if "predictions" in frames else {}),
    }


def _count_missing(frames: Mapping[str, pd.DataFrame]) -> int:
    """Return how many held-out insertions have no prediction, for too few draws had a solution."""
    replicates = frames["replicates"]
    asked = sum(str(name).startswith(f"{RANK_PREFIX}{HELD_OUT_TIP}:") for name in replicates)
    return asked * len(replicates) - len(frames["predictions"])


def find_calibration_faults(outcome: Mapping[str, Any]) -> Iterator[str]:
    """Yield why a calibration is not passed, from its outcome."""
    if not outcome["conclusive"] and (outcome["control"] or not outcome["not_calibrated"]):
        yield f"{outcome['replicates']} replicates are too few to decide"
    elif outcome["not_calibrated"] and not outcome["passes"]:
        yield f"not calibrated: {', '.join(outcome['not_calibrated'])}"
    elif not outcome["passes"]:
        yield f"the control `{outcome['control']}` is not noticed"
    if outcome["untrusted"] and outcome["control"] is None:
        yield f"{outcome['untrusted']} posteriors have not converged"
    if outcome.get("not_predicted"):
        yield f"{outcome['not_predicted']} held-out insertions could not be predicted"
