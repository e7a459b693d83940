"""The verb: draw parameters from the prior, insert, infer, many times; does the truth look like a draw?

S. Talts, M. Betancourt, D. Simpson, A. Vehtari, A. Gelman, arXiv 1804.06788; the log likelihood among what is
ranked is from M. Modrak et al., Bayesian Anal. 20 (2025) 461.
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from needlefit.datasets.insertion import Insertion
from needlefit.errors import ConfigError, FitError
from needlefit.project.processes import in_processes
from needlefit.project.records.fit import FitRecord
from needlefit.project.result_warnings import stored
from needlefit.project.threads import one_thread
from needlefit.project.toml_lines import place_of
from needlefit.validation import provenance
from needlefit.validation.calibration.controls import Control
from needlefit.validation.calibration.judged import coverage, ecdfs, failing
from needlefit.validation.calibration.quantities import stiffest
from needlefit.validation.calibration.ranks import DRAWS
from needlefit.validation.calibration.replicate import Experiment, replicate
from needlefit.validation.checkpoint import open_checkpoint
from needlefit.validation.design import looked_at, planned
from needlefit.validation.folds import Fold
from needlefit.validation.job import Job, Settings, prepare

ROWS = "replicates"
RANK = "rank_"

FEW = 3
"""Insertions of the design whose posteriors the sampler draws: the shallowest, the middle and the deepest."""


@dataclass(frozen=True)
class Calibration:
    """What came of all replicates.

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
        As in `judged`.
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
        """Quantities that are not calibrated."""
        return failing(self.coverage, self.ecdfs)

    @property
    def telling(self) -> bool:
        """Whether there are replicates enough to fail: no truth at all in a half would be too few."""
        half = self.coverage[self.coverage["level"] == min(self.coverage["level"])]
        return bool((half["least"] > 0).all())

    @property
    def untrusted(self) -> int:
        """Replicates whose posterior nobody certified: they count like all others."""
        return int((~self.replicates["trusted"].astype(bool)).sum())

    @property
    def passes(self) -> bool:
        """Whether the outcome is as it should be: calibrated, or, where the likelihood is wrong, not."""
        return bool(self.failing) == (self.control is not None)


@one_thread
def calibrate(
    name: str, record: FitRecord, settings: Settings, replicates: int, control: Control | None = None
) -> Calibration:
    """Return how often the truth of `replicates` random insertions was where its posterior says.

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
    experiment = _experiment(prepare(name, record, settings), settings.sample, control)
    job = experiment.job
    asked = {"sampled": settings.sample, "control": control, "draws": DRAWS}
    run = {**provenance.work(job), **asked, "stiff_design": dict(experiment.stiff)}
    checkpoint = open_checkpoint(settings.checkpoint, settings.resume, run, settings.note)
    known = {
        row["replicate"]: row
        for row in checkpoint.rows(ROWS, ("replicate",))
        if row["replicate"] < replicates
    }
    left = [number for number in range(replicates) if number not in known]
    label = f"{name}: replicates"
    settings.progress(label, len(known), replicates)
    work = partial(replicate, experiment=experiment)
    for _, row in in_processes(work, left, settings.jobs, settings.stop):
        known[row["replicate"]] = row
        checkpoint.keep_row(ROWS, row)
        settings.progress(label, len(known), replicates)
    return _calibration(experiment, known, run, time.time() - begin, len(known) < replicates)


def _experiment(job: Job, sampled: bool, control: Control | None) -> Experiment:
    """Return what is repeated.

    Raises
    ------
    ConfigError
        If the dataset states no noise, or nothing is free.
    """
    if not job.dataset.noise.stated:
        raise ConfigError(
            f"the dataset `{job.dataset.name}` states no noise: nothing can be drawn from it",
            where=place_of(job.dataset.path, "noise.point_sd_mm"),
            expected="[noise] with point_sd_mm or correlated_sd_mm above 0",
        )
    if not job.parameters.free:
        raise ConfigError(f"nothing of medium `{job.record.medium}` is free: there is nothing to infer")
    fold = job.folds[0]
    if sampled:
        fold = Fold(fold.name, _few(fold.tune), ())
    values, place = looked_at(job)
    design = planned(job, fold, values)
    if design is None:
        raise FitError(f"the planned insertions have no solution at {place}", mend="name a hand-tuned set")
    stiff = stiffest(design, design.parameters.theta(values))
    weights = dict(zip(design.names, stiff.tolist(), strict=True))
    return Experiment(replace(job, folds=(fold,)), weights, sampled, control)


def _few(insertions: tuple[Insertion, ...]) -> tuple[Insertion, ...]:
    by_depth = sorted(insertions, key=lambda one: one.depth)
    if len(by_depth) <= FEW:
        return insertions
    return tuple(by_depth[k] for k in (0, len(by_depth) // 2, -1))


def _calibration(
    experiment: Experiment,
    rows: Mapping[int, dict[str, Any]],
    run: dict[str, Any],
    seconds: float,
    interrupted: bool,
) -> Calibration:
    job, (fold,) = experiment.job, experiment.job.folds
    frame = pd.DataFrame([rows[number] for number in sorted(rows)])
    ranks = {
        column.removeprefix(RANK): frame[column].to_numpy(dtype=np.int64)
        for column in frame.columns
        if column.startswith(RANK)
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
        coverage=coverage(ranks),
        ecdfs=ecdfs(ranks) if ranks else pd.DataFrame(),
        run={**run, "replicates": len(frame), **stored(job.warnings)},
        seconds=seconds,
        interrupted=interrupted,
    )
