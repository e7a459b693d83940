"""How an inquiry is carried out, whatever it asks: piece by piece, what it was computed with beside it."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import pandas as pd

from needlefit.inference.parameters import Parameters
from needlefit.project.records.inquiry import InquiryRecord
from needlefit.project.records.study import StudyRecord
from needlefit.project.result_warnings import ResultWarning, stored
from needlefit.validation import provenance
from needlefit.validation.checkpoint import open_checkpoint
from needlefit.validation.fit_warnings import analysis_bound_warnings
from needlefit.validation.folds import Fold, shared_specimens
from needlefit.validation.inquiries.answer import Answer
from needlefit.validation.inquiries.pieces import Piece, piecewise
from needlefit.validation.job import Job, Settings

Frames = dict[str, pd.DataFrame]


def _nothing(frames: Frames) -> tuple[str, ...]:
    return ()


@dataclass(frozen=True)
class Plan:
    """What an inquiry computes.

    Attributes
    ----------
    jobs : sequence of Job
        The fits that it is about, for data, configuration and rules.
    pieces : mapping
        The work, by keys that say what each piece is.
    columns : mapping
        The columns of every frame, which it has even without rows.
    conclude : callable
        What is left to compute once all pieces are there: adds frames to those of the pieces, in place, and
        returns the faults. It must be quick: it is not kept.
    also : mapping
        Whatever else decides the answer, as JSON values.
    folds : sequence of Fold
        What is held out besides the jobs' own folds.
    parameters : mapping
        Those of the fits in the frame `fits`, by its first column, if values at bounds are to be named.
    """

    jobs: Sequence[Job]
    pieces: Mapping[str, Piece]
    columns: Mapping[str, Sequence[str]]
    conclude: Callable[[Frames], tuple[str, ...]] = _nothing
    also: Mapping[str, Any] | None = None
    folds: Sequence[Fold] = ()
    parameters: Mapping[str, Parameters] = field(default_factory=dict)


def answered(name: str, record: InquiryRecord, settings: Settings, plan: Plan) -> Answer:
    """Carry out a plan and return the answer; after an interruption with `resume` it is the same answer.

    Raises
    ------
    ConfigError
        If the checkpoint belongs to other work.
    """
    begin = time.time()
    work = _work(name, record, plan)
    checkpoint = open_checkpoint(settings.checkpoint, settings.resume, work, settings.note)
    rows, interrupted = piecewise(plan.pieces, name, settings, checkpoint)
    frames = {frame: _frame(rows.get(frame, []), columns) for frame, columns in plan.columns.items()}
    faults = () if interrupted else plan.conclude(frames)
    at_bounds = analysis_bound_warnings(frames["fits"], plan.parameters) if plan.parameters else ()
    datasets = {job.dataset.name: job.dataset for job in plan.jobs}.values()
    return Answer(
        name=name,
        record=record,
        origin="synthetic" if any(one.origin == "synthetic" for one in datasets) else "measured",
        dataset_title="; ".join(dict.fromkeys(one.title or one.name for one in datasets)),
        frames=frames,
        run={
            **work,
            "interrupted": interrupted,
            "faults": list(faults),
            **stored([*_warnings(name, record, plan, settings.place("same_specimen")), *at_bounds]),
        },
        timing={"seconds": time.time() - begin, "jobs": settings.jobs},
        interrupted=interrupted,
        faults=faults,
    )


def _warnings(name: str, record: InquiryRecord, plan: Plan, where: str) -> list[ResultWarning]:
    """Return the warnings about the data, and about what is held out; a job that is a study has its own."""
    found = [one for job in plan.jobs for one in job.warnings]
    divided = [fold for job in plan.jobs if not isinstance(job.record, StudyRecord) for fold in job.folds]
    if record.same_specimen:
        return found
    return [*found, *shared_specimens(name, [*divided, *plan.folds], where)]


def _work(name: str, record: InquiryRecord, plan: Plan) -> dict[str, Any]:
    """Return all that decides the answer; each dataset, medium and recipe stands there once."""
    each = [provenance.work(job) for job in plan.jobs]
    parts = [{key: one[key] for key in _PARTS} for one in each]
    return {
        "name": name,
        "versions": provenance.versions(provenance.PACKAGES),
        "study": record.model_dump(mode="json", by_alias=True),
        "datasets": {one["dataset"]["name"]: one["dataset"] for one in each},
        "parts": [part for i, part in enumerate(parts) if part not in parts[:i]],
        **(plan.also or {}),
    }


_PARTS = ("medium", "recipe", "rules", "hand_tuned", "folds")


def _frame(rows: Sequence[Mapping[str, Any]], columns: Sequence[str]) -> pd.DataFrame:
    return pd.DataFrame(list(rows), columns=list(columns))
