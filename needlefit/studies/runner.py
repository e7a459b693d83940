"""Run an analysis of any kind: checkpointed tasks, then a conclusion; the result has its provenance."""

import json
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Generic, TypeVar

import pandas as pd

from needlefit.inference.parameters import Parameters
from needlefit.project.checkpoint import Checkpoint, open_checkpoint
from needlefit.project.result_warnings import ResultWarning, warnings_entry
from needlefit.schemas.analyses import AnalysisRecord
from needlefit.schemas.study import StudyRecord
from needlefit.studies.fit_warnings import analysis_bound_warnings
from needlefit.studies.job import Fold, Job, Settings, warn_shared_specimens
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
        """Return the value."""
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
) -> Iterator[FrameRows]:
    """Yield the rows of each task, in the order of the tasks, once it and all before it are done.

    Each task has a file of the checkpoint, or a temporary one: memory does not grow with their number. A stop
    leaves tasks undone; those that are done are yielded all the same. Where several tasks are left, `shared`
    is called before them.

    A task that a stop interrupts is discarded: its rows would be incomplete.
    """
    with TemporaryDirectory(prefix="needlefit-") as spare:
        kept = replace(checkpoint, folder=checkpoint.folder or Path(spare))

        def read(key: str) -> list[FrameRows]:
            return [row["rows"] for row in kept.rows(f"task {key}", ("rows",))]

        finished = {key for key in tasks if read(key)}
        left, due = [key for key in tasks if key not in finished], deque(tasks)
        settings.progress(label, len(finished), len(tasks))
        for compute in shared if len(left) > 1 else ():
            compute()
        while due and due[0] in finished:
            yield read(due.popleft())[0]
        for n, text in settings.task_pool().run(_compute_rows, [tasks[key] for key in left], settings.stop):
            if settings.stop():
                break
            kept.keep_row(f"task {left[n]}", {"rows": json.loads(text)})
            finished.add(left[n])
            settings.progress(f"{label}: {left[n]}", len(finished), len(tasks))
            while due and due[0] in finished:
                yield read(due.popleft())[0]
        for key in due:
            if key in finished:
                yield read(key)[0]


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


def _make_frames(parts: Iterable[FrameRows], columns: Mapping[str, Sequence[str]]) -> Frames:
    """Return the rows of all tasks as frames in memory."""
    rows = join_rows(parts)
    return {name: pd.DataFrame(rows.get(name, []), columns=list(names)) for name, names in columns.items()}


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
    folds: Sequence[Fold] = ()  #: what is held out besides the jobs' own folds
    #: those of the fits in the frame `fits`, by its first column, if values at bounds are to be named
    parameters: Mapping[str, Parameters] = field(default_factory=dict)
    #: compute what several tasks need and keep, before the tasks are sent to other processes
    shared: Sequence[Callable[[], object]] = ()
    warnings: Sequence[ResultWarning] = ()  #: about the data, besides those of the jobs
    #: rows of each task, and `columns` -> the frames
    collect: Callable[[Iterable[FrameRows], Mapping[str, Sequence[str]]], Frames] = _make_frames


def run_analysis(name: str, record: AnalysisRecord, settings: Settings, plan: AnalysisPlan) -> Run:
    """Run the tasks of a plan; an interrupted run with `resume` gives the same result.

    Raises ConfigError if the checkpoint belongs to other work.
    """
    work = _describe_configuration(name, record, plan)
    checkpoint = open_checkpoint(settings.checkpoint, settings.resume, work, settings.note)
    done = 0

    def count_parts() -> Iterator[FrameRows]:
        nonlocal done
        for part in run_tasks(plan.tasks, name, settings, checkpoint, plan.shared):
            done += 1
            yield part

    frames = plan.collect(count_parts(), plan.columns)
    interrupted = done < len(plan.tasks)
    faults = () if interrupted else plan.conclude(frames)
    at_bounds = analysis_bound_warnings(frames["fits"], plan.parameters) if plan.parameters else ()
    datasets = {job.dataset.name: job.dataset for job in plan.jobs}.values()
    found = [*(one for job in plan.jobs for one in job.warnings), *plan.warnings]
    if not record.same_specimen:  # a job that is a study has warnings of its own
        fits = (job for job in plan.jobs if not isinstance(job.record, StudyRecord))
        divided = [*(fold for job in fits for fold in job.folds), *plan.folds]
        found += warn_shared_specimens(name, divided, settings.place("same_specimen"))
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
