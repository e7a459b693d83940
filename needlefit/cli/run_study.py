"""Run the studies that a name means; write and print their results.

Several studies and fits run side by side, one in each process: much of a fit keeps Python busy, which threads
of one process cannot share. Studies whose work falls into tasks follow one after the other.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from multiprocessing import parent_process
from pathlib import Path

from needlefit.cli import screen
from needlefit.cli.execution import Execution
from needlefit.cli.progress import show_progress
from needlefit.cli.show_results import show_run, show_warnings
from needlefit.project.checkpoint import hold_checkpoint, release_checkpoint
from needlefit.project.load import load
from needlefit.project.locate import EVERY_STUDY, find_studies, find_tunings
from needlefit.project.tasks import LocalPool, stop_requested, threads_of_task
from needlefit.project.toml_lines import add_file_context
from needlefit.schemas.base import FileRecord
from needlefit.schemas.study import FitRecord, StudyRecord
from needlefit.studies.run import Run
from needlefit.studies.study_files import find_missing_data, load_study


@dataclass(frozen=True)
class StudyTask:
    """A study, or a fit of the paper's tuning tables, that is to be carried out."""

    name: str
    record: FileRecord
    file: Path


@dataclass(frozen=True)
class StudyOutcomes:
    """The runs of some studies, in their order."""

    runs: list[Run] = field(default_factory=list)

    def faults(self) -> list[str]:
        """Return why something in them is not to be trusted."""
        return [f"{one.name}: {fault}" for one in self.runs for fault in one.faults]

    def as_json(self) -> object:
        """Return the runs as plain values: a single one as it is, several by name."""
        from needlefit.studies.report import run_to_json

        every: dict[str, object] = {one.name: run_to_json(one) for one in self.runs}
        return next(iter(every.values())) if len(every) == 1 else every


def plan_studies(study: str) -> list[StudyTask]:
    """Return what a name means; of `everything`, studies without their data are left out, with a note.

    Raises
    ------
    ConfigError
        If there is no such study, or its file does not hold what its kind wants.
    """
    found = []
    for name, path in find_studies(study):
        missing = find_missing_data(path) if study == EVERY_STUDY else []
        if missing:
            screen.print_note(f"needlefit: {name} is left out: the data of {', '.join(missing)} are not here")
        else:
            found.append(StudyTask(name, load_study(path), path))
    return [*found, *(StudyTask(name, load(path, FitRecord), path) for name, path in find_tunings(study))]


def run_studies(execution: Execution, todo: Sequence[StudyTask], json: bool) -> StudyOutcomes:
    """Run, write and print every work; their checkpoints stay."""
    done = StudyOutcomes()
    for result in _run_each(execution, todo):
        if result.interrupted:
            break
        if json:
            show_warnings(execution.invocation, result)
        else:
            show_run(execution.invocation, result, execution.folder(result.name), len(todo) > 1)
            if len(todo) > 1:
                screen.print_line()
        done.runs.append(result)
    if len(done.runs) < len(todo):
        raise execution.interrupted()
    return done


def _run_each(execution: Execution, todo: Sequence[StudyTask]) -> Iterable[Run]:
    """Run and write the studies; yield them in their order, not all where Ctrl-C asks to stop."""
    fits = all(isinstance(work.record, FitRecord | StudyRecord) for work in todo)
    if not fits or len(todo) == 1 or not isinstance(execution.pool, LocalPool) or execution.pool.size == 1:
        return map(partial(_run_one, execution), todo)
    # a process among several shows no progress of its own
    quiet = replace(execution.invocation, quiet=True)
    sent = partial(_run_in_process, replace(execution, invocation=quiet, stop=_stop_in_process, pool=None))
    finished: dict[int, Run] = {}
    with show_progress(execution.invocation.quiet) as report:
        report(f"{len(todo)} studies side by side", 0, len(todo))
        for n, result in execution.pool.run(sent, todo, execution.stop):
            finished[n] = result
            hold_checkpoint(execution.checkpoint(result.name))
            report(f"studies: {result.name}", len(finished), len(todo))
    return [finished[n] for n in sorted(finished)]


def _stop_in_process() -> bool:
    """Return whether to stop: it was asked for, or the program that began this process has ended."""
    program = parent_process()
    return stop_requested() or not (program is None or program.is_alive())


def _run_in_process(execution: Execution, work: StudyTask) -> Run:
    result = _run_one(replace(execution, jobs=threads_of_task()), work)
    release_checkpoint(execution.checkpoint(work.name))  # the program that began this process takes it
    return result


def _run_one(execution: Execution, work: StudyTask) -> Run:
    """Run one study and, unless it was interrupted, write it."""
    with add_file_context(work.file):
        result = replace(execution, file=work.file).run(work.name, work.record)
        if not result.interrupted:
            execution.write(result)
    return result
