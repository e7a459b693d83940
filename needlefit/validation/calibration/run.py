"""Run simulation-based calibration: draw parameters from the prior, simulate, infer, and rank the truth.

S. Talts, M. Betancourt, D. Simpson, A. Vehtari, A. Gelman, arXiv 1804.06788; the log likelihood among what is
ranked is from M. Modrak et al., Bayesian Anal. 20 (2025) 461.
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from needlefit.datasets.insertion import Insertion
from needlefit.errors import ConfigError, FitError
from needlefit.project.input_files import convert_stored_errors
from needlefit.project.json_values import to_json_values
from needlefit.project.processes import run_in_processes
from needlefit.project.result_warnings import warnings_entry
from needlefit.project.run_file import read_timing, require_schema
from needlefit.project.threads import one_thread
from needlefit.project.toml_lines import locate_key
from needlefit.schemas.result_files import CalibrationTable
from needlefit.schemas.study import FitRecord
from needlefit.validation import provenance
from needlefit.validation.calibration.quantities import best_determined_direction
from needlefit.validation.calibration.rank_statistics import (
    RANK_DRAWS,
    find_failing,
    tabulate_coverage,
    tabulate_ecdfs,
)
from needlefit.validation.calibration.replicate import Control, Experiment, replicate
from needlefit.validation.checkpoint import open_checkpoint
from needlefit.validation.folds import Fold
from needlefit.validation.job import Job, Settings, prepare
from needlefit.validation.packing import RESULTS_FILE, pack, pack_frame, unpack_frame
from needlefit.validation.planned_insertions import choose_reference_values, simulate_design

CHECKPOINT_ROWS = "replicates"
RANK_PREFIX = "rank_"

MAX_SAMPLED_INSERTIONS = 3
"""Insertions of the design whose posteriors the sampler draws: the shallowest, the middle and the deepest."""


@dataclass(frozen=True)
class Calibration:
    """The result of all replicates.

    Attributes
    ----------
    name, title : str
        Of the target.
    origin : str
        "measured" or "synthetic", of the dataset that the design is of.
    dataset_title : str
    control : Control or None
        In what the likelihood was wrong on purpose.
    sampled : bool
        Whether the sampler drew every posterior.
    insertions, depths : tuples
        Names and depths (mm) of the design's.
    replicates : DataFrame
        A row each: truth, ranks, and how they were computed.
    coverage, ecdfs : DataFrame
        As in `rank_statistics`.
    run : dict
        Versions, data and configuration; no time and no path.
    seconds : float
    interrupted : bool
    """

    name: str
    title: str
    origin: str
    dataset_title: str
    control: Control | None
    sampled: bool
    insertions: tuple[str, ...]
    depths: tuple[float, ...]
    replicates: pd.DataFrame
    coverage: pd.DataFrame
    ecdfs: pd.DataFrame
    run: dict[str, Any]
    seconds: float
    interrupted: bool

    @property
    def failing(self) -> list[str]:
        """The quantities that are not calibrated."""
        return find_failing(self.coverage, self.ecdfs)

    @property
    def conclusive(self) -> bool:
        """Whether there are enough replicates to detect a failure."""
        half = self.coverage[self.coverage["level"] == min(self.coverage["level"])]
        return bool((half["count_low"] > 0).all())

    @property
    def untrusted(self) -> int:
        """The number of replicates whose posterior is not certified; they count like all others."""
        return int((~self.replicates["trusted"].astype(bool)).sum())

    @property
    def passes(self) -> bool:
        """Whether the outcome is as expected: calibrated, or not if the likelihood is wrong on purpose."""
        return bool(self.failing) == (self.control is not None)


@one_thread
def calibrate(
    name: str, record: FitRecord, settings: Settings, replicates: int, control: Control | None = None
) -> Calibration:
    """Return the ranks of the truth in its posterior for `replicates` random insertions.

    With `settings.sample` the posteriors of at most three insertions are drawn by the sampler. The same
    record, data, seed and versions give the same result for any number of jobs and after an interruption.

    Raises
    ------
    ConfigError, DataError
        If anything the record names is missing or wrong, or no noise is stated.
    FitError
        If the design has no solution where it is looked at, or nowhere in the prior.
    """
    begin = time.time()
    experiment = _prepare_experiment(prepare(name, record, settings), settings.sample, control)
    job = experiment.job
    asked = {"sampled": settings.sample, "control": control, "draws": RANK_DRAWS}
    run = {**provenance.describe_configuration(job), **asked, "stiff_design": dict(experiment.stiff)}
    checkpoint = open_checkpoint(settings.checkpoint, settings.resume, run, settings.note)
    known = {
        row["replicate"]: row
        for row in checkpoint.rows(CHECKPOINT_ROWS, ("replicate",))
        if row["replicate"] < replicates
    }
    left = [number for number in range(replicates) if number not in known]
    label = f"{name}: replicates"
    settings.progress(label, len(known), replicates)
    work = partial(replicate, experiment=experiment)
    for _, row in run_in_processes(work, left, settings.jobs, settings.stop):
        known[row["replicate"]] = row
        checkpoint.keep_row(CHECKPOINT_ROWS, row)
        settings.progress(label, len(known), replicates)
    return _summarize_replicates(experiment, known, run, time.time() - begin, len(known) < replicates)


def _prepare_experiment(job: Job, sampled: bool, control: Control | None) -> Experiment:
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
    if sampled:
        fold = Fold(fold.name, _select_few(fold.tune), ())
    values, place = choose_reference_values(job)
    design = simulate_design(job, fold, values)
    if design is None:
        raise FitError(f"the planned insertions have no solution at {place}", fix="name a hand-tuned set")
    stiff = best_determined_direction(design, design.parameters.theta(values))
    weights = dict(zip(design.names, stiff.tolist(), strict=True))
    return Experiment(replace(job, folds=(fold,)), weights, sampled, control)


def _select_few(insertions: tuple[Insertion, ...]) -> tuple[Insertion, ...]:
    by_depth = sorted(insertions, key=lambda one: one.depth)
    if len(by_depth) <= MAX_SAMPLED_INSERTIONS:
        return insertions
    return tuple(by_depth[k] for k in (0, len(by_depth) // 2, -1))


def _summarize_replicates(
    experiment: Experiment,
    rows: Mapping[int, dict[str, Any]],
    run: dict[str, Any],
    seconds: float,
    interrupted: bool,
) -> Calibration:
    job, (fold,) = experiment.job, experiment.job.folds
    frame = pd.DataFrame([rows[number] for number in sorted(rows)])
    ranks = {
        column.removeprefix(RANK_PREFIX): frame[column].to_numpy(dtype=np.int64)
        for column in frame.columns
        if column.startswith(RANK_PREFIX)
    }
    return Calibration(
        name=job.name,
        title=job.record.title or job.name,
        origin=job.dataset.origin,
        dataset_title=job.dataset.title or job.dataset.name,
        control=experiment.control,
        sampled=experiment.sampled,
        insertions=tuple(one.id for one in fold.tune),
        depths=tuple(one.depth for one in fold.tune),
        replicates=frame,
        coverage=tabulate_coverage(ranks),
        ecdfs=tabulate_ecdfs(ranks) if ranks else pd.DataFrame(),
        run={**run, "replicates": len(frame), **warnings_entry(job.warnings)},
        seconds=seconds,
        interrupted=interrupted,
    )


CALIBRATION_KIND = "calibration"

_PLAIN = ("name", "title", "origin", "dataset_title", "control", "sampled", "interrupted", "run")
_TUPLES = ("insertions", "depths")
_FRAMES = ("replicates", "coverage", "ecdfs")


def store_calibration(found: Calibration, folder: Path) -> Path:
    """Write a calibration without its time to `folder`; equal ones give equal bytes."""
    table = {key: to_json_values(getattr(found, key)) for key in _PLAIN}
    table |= {key: list(getattr(found, key)) for key in _TUPLES}
    frames = {key: pack_frame(getattr(found, key)) for key in _FRAMES}
    return pack({"kind": CALIBRATION_KIND, **table, "frames": frames}, folder)


def restore_calibration(table: Mapping[str, Any], folder: Path) -> Calibration:
    """Read the calibration that a run stored as `table` in `folder`; DataError if it is damaged."""
    require_schema(table, CalibrationTable, str(folder / RESULTS_FILE))
    seconds = read_timing(folder).get("seconds", 0.0)
    about: dict[str, Any] = {key: table[key] for key in _PLAIN}
    about |= {key: tuple(table[key]) for key in _TUPLES}
    with convert_stored_errors(folder / RESULTS_FILE):
        about |= {key: unpack_frame(table["frames"][key]) for key in _FRAMES}
        return Calibration(seconds=seconds, **about)
