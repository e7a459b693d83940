"""Run an analysis of any kind: checkpointed tasks, then a conclusion; the result has its provenance."""

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Generic, TypeVar

import pandas as pd

from needlefit.inference.parameters import Parameters
from needlefit.project.checkpoint import Checkpoint, open_checkpoint
from needlefit.project.result_warnings import ResultWarning, warnings_entry
from needlefit.schemas.analyses import AnalysisRecord
from needlefit.schemas.study import StudyRecord
from needlefit.studies.fit_warnings import analysis_bound_warnings
from needlefit.studies.job import Job, Settings, warn_shared_specimens
from needlefit.studies.provenance import PACKAGES, describe_configuration, package_versions
from needlefit.studies.run import Frames, Run
from needlefit.studies.score import Row
from needlefit.studies.store import to_json_value

FrameRows = dict[str, list[Row]]  #: rows by the name of the frame that they belong to

Value = TypeVar("Value")

#: computes the rows of one task from its arguments alone; its random streams are keyed by them too
AnalysisTask = Callable[[], FrameRows]


class Shared(Generic[Value]):
    """A value that several tasks need: computed by the first call, and sent with the tasks."""

    def __init__(self, compute: Callable[[], Value]) -> None:
        self._compute = compute

    def __call__(self) -> Value:
        return self._value

    @cached_property
    def _value(self) -> Value:
        return self._compute()


def run_tasks(
    tasks: Mapping[str, AnalysisTask],
    label: str,
    settings: Settings,
    checkpoint: Checkpoint,
    shared: Sequence[Callable[[], object]] = (),
) -> list[FrameRows]:
    """Return the rows of each task that is done, in the order of the tasks; each has its checkpoint.

    Where several tasks are left, `shared` is called before them. A stop leaves tasks undone; one that it
    interrupts is discarded, because its rows would be incomplete.
    """
    kept = {key: checkpoint.rows(f"task {key}", ("rows",)) for key in tasks}
    finished: dict[str, FrameRows] = {key: rows[0]["rows"] for key, rows in kept.items() if rows}
    left = [key for key in tasks if key not in finished]
    settings.progress(label, len(finished), len(tasks))
    for compute in shared if len(left) > 1 else ():
        compute()
    for n, text in settings.task_pool().run(_compute_rows, [tasks[key] for key in left], settings.stop):
        if settings.stop():
            break
        key, rows = left[n], json.loads(text)
        checkpoint.keep_row(f"task {key}", {"rows": rows})
        finished[key] = rows
        settings.progress(f"{label}: {key}", len(finished), len(tasks))
    return [finished[key] for key in tasks if key in finished]


def _compute_rows(task: AnalysisTask) -> str:
    """Return the rows of a task as JSON: fresh ones are the same as rows read from a checkpoint."""
    return json.dumps(task(), default=to_json_value)


def join_rows(parts: Iterable[FrameRows]) -> FrameRows:
    """Return the rows of several tasks, one after the other."""
    every: FrameRows = {}
    for part in parts:
        for frame, rows in part.items():
            every.setdefault(frame, []).extend(rows)
    return every


def list_faults(counts: Mapping[str, int]) -> tuple[str, ...]:
    """Return what went wrong how often, as faults of a run; `counts` are by words."""
    return tuple(f"{count} {words}" for words, count in counts.items() if count)


@dataclass(frozen=True)
class AnalysisPlan:
    """The tasks, tables and conclusion of an analysis."""

    jobs: Sequence[Job]  #: the fits that it is about, for data, configuration and rules
    tasks: Mapping[str, AnalysisTask]  #: the work, by keys that say what each task is
    columns: Mapping[str, Sequence[str]]  #: the columns of every frame, which it has even without rows
    #: What is left to compute once all tasks are done: adds frames to those of the tasks, in place, and
    #: returns the faults. It must be quick: it is not kept.
    conclude: Callable[[Frames], tuple[str, ...]] = lambda frames: ()
    also: Mapping[str, Any] | None = None  #: whatever else decides the result, as JSON values
    #: those of the fits in the frame `fits`, by its first column, if values at bounds are to be named
    parameters: Mapping[str, Parameters] = field(default_factory=dict)
    #: compute what several tasks need and keep, before the tasks are sent to other processes
    shared: Sequence[Callable[[], object]] = ()
    warnings: Sequence[ResultWarning] = ()  #: about the data, besides those of the jobs


def run_analysis(name: str, record: AnalysisRecord, settings: Settings, plan: AnalysisPlan) -> Run:
    """Run the tasks of a plan; an interrupted run with `resume` gives the same result.

    Raises ConfigError if the checkpoint belongs to other work.
    """
    work = _describe_configuration(name, record, plan)
    checkpoint = open_checkpoint(settings.checkpoint, settings.resume, work, settings.note)
    parts = run_tasks(plan.tasks, name, settings, checkpoint, plan.shared)
    rows, interrupted = join_rows(parts), len(parts) < len(plan.tasks)
    frames: Frames = {
        frame: pd.DataFrame(rows.get(frame, []), columns=list(names)) for frame, names in plan.columns.items()
    }
    faults = () if interrupted else plan.conclude(frames)
    at_bounds = analysis_bound_warnings(frames["fits"], plan.parameters) if plan.parameters else ()
    datasets = {job.dataset.name: job.dataset for job in plan.jobs}.values()
    found = [*(one for job in plan.jobs for one in job.warnings), *plan.warnings]
    if not record.same_specimen:  # a job that is a study has warnings of its own
        folds = (f for job in plan.jobs if not isinstance(job.record, StudyRecord) for f in job.folds)
        found += warn_shared_specimens(name, folds, settings.place("same_specimen"))
    return Run(
        kind=str(record.kind),
        name=name,
        record=record,
        origin="synthetic" if any(one.origin == "synthetic" for one in datasets) else "measured",
        dataset_title="; ".join(dict.fromkeys(one.title or one.name for one in datasets)),
        frames=frames,
        run={**work, **warnings_entry([*found, *at_bounds])},
        timing={},
        interrupted=interrupted,
        faults=faults,
    )


def _describe_configuration(name: str, record: AnalysisRecord, plan: AnalysisPlan) -> dict[str, Any]:
    """Return all that decides the result; each dataset, medium and recipe stands there once."""
    each = [describe_configuration(job) for job in plan.jobs]
    parts = [{key: one[key] for key in _PARTS} for one in each]
    return {
        "name": name,
        "versions": package_versions(PACKAGES)
        | {package: version for one in each for package, version in one["versions"].items()},
        "study": record.model_dump(mode="json", by_alias=True),
        "datasets": {one["dataset"]["name"]: one["dataset"] for one in each},
        "parts": [part for i, part in enumerate(parts) if part not in parts[:i]],
        **(plan.also or {}),
    }


_PARTS = ("medium", "recipe", "rules", "hand_tuned", "folds")
