"""Run studies as options state: progress, folders of results and checkpoints, what is printed of them."""

import math
import re
import shlex
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

import typer

from needlefit.cli import exit_codes, screen
from needlefit.cli.exit_codes import Invocation, catch_interrupts
from needlefit.project.callbacks import Progress, never_stop, no_note, no_progress
from needlefit.project.locate import format_path
from needlefit.project.processes import count_cores, leave_out_help_texts

if TYPE_CHECKING:
    from needlefit.datasets.insertion import Dataset
    from needlefit.project.tasks import TaskPool
    from needlefit.schemas.base import FileRecord
    from needlefit.studies.first_page import Advice
    from needlefit.studies.job import Inputs, StatedStudy
    from needlefit.studies.run import Run

# ---- how far a long run is, and the time left: a bar on a terminal, otherwise a line a minute; on stderr


LINE_INTERVAL_SECONDS = 60.0  # shortest time (s) between two lines of progress in a pipe or file
MIN_PACE_PART = 0.25
"""Smallest fraction of the work after which its pace gives the time left: the first steps take the
longest."""


@contextmanager
def show_progress(quiet: bool) -> Iterator[Progress]:
    """Yield the function that a run calls with what it does, how many steps are done, and of how many."""
    if quiet:
        yield no_progress
    elif sys.stderr.isatty():
        with _bar() as report:
            yield report
    else:
        yield report_lines(sys.stderr)


def report_lines(stream: TextIO) -> Progress:
    """Return a reporter that writes at most one line a minute, with the time left at the mean pace."""
    lock, last, estimate_left = threading.Lock(), [time.monotonic()], begin_estimates()

    def report(label: str, done: int, total: int) -> None:
        with lock:
            left = estimate_left(done, total)
            if (now := time.monotonic()) - last[0] >= LINE_INTERVAL_SECONDS:
                last[0] = now
                print(f"needlefit: {label}: {done} of {total}{left and f', {left}'}", file=stream, flush=True)

    return report


def begin_estimates() -> Callable[[int, int], str]:
    """Return what gives the time left, in words, of what is done and the whole; "" while it is not known.

    What an earlier run has done, before the first call, says nothing of the pace.
    """
    first = list[tuple[float, int]]()

    def estimate_left(done: int, total: int) -> str:
        now = time.monotonic()
        if not first:
            first.append((now, done))
        ((begin, before),) = first
        if done <= before or done - before < MIN_PACE_PART * (total - before):
            return ""
        seconds = (now - begin) / (done - before) * (total - done)
        return f"about {seconds / 60:.0f} min left" if seconds >= 90 else f"about {seconds:.0f} s left"

    return estimate_left


@contextmanager
def _bar() -> Iterator[Progress]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("{task.fields[left]}"))
    estimate_left = begin_estimates()
    # without its thread: a process with threads is not forked (`project.tasks`)
    with Progress(
        TextColumn("{task.description}"),
        *columns,
        console=Console(stderr=True),
        transient=True,
        auto_refresh=False,
    ) as bar:
        task = bar.add_task("starting", total=None, left="")

        def report(label: str, done: int, total: int) -> None:
            left = estimate_left(done, total)
            bar.update(task, description=label, completed=done, total=total, left=left, refresh=True)

        yield report


# ---- runs


@dataclass(frozen=True)
class Execution:
    """How runs of a command go; results go to `OUT/<name>/`, checkpoints to `OUT/<name>.partial/`.

    `stop`: whether to end early. `sources` are the files of which each result is made, by its name; `prepare`
    fills them. `pool`: the workers of a cluster.
    """

    invocation: Invocation
    stop: Callable[[], bool] = never_stop
    sources: "dict[str, Sequence[str]]" = field(default_factory=dict)
    pool: "TaskPool | None" = None

    def prepare_result(self, name: str, sources: Sequence[str], record: "FileRecord | None" = None) -> None:
        """Make sure, as `prepare`, that the result of some files, and of a study or fit, can be written.

        ConfigError also if it would replace the result of others.
        """
        from needlefit.studies.run import require_same_sources

        self.prepare([name])
        require_same_sources(self.folder(name), sources, record)
        self.sources[name] = sources

    def prepare(self, names: Iterable[str], referenced: Iterable[str] = ()) -> None:
        """Make sure, before hours of work, that the results can be written, and reference results if wanted.

        ConfigError if they cannot, or would replace something that needlefit did not write.
        """
        from needlefit.project.checkpoint import require_own_checkpoint
        from needlefit.project.folders import require_replaceable

        references = [f"reference/{name}" for name in referenced if self.invocation.reference]
        for name in (*names, *references):
            require_replaceable(self.folder(name))
            require_own_checkpoint(self.checkpoint(name))

    def folder(self, name: str) -> Path:
        """Return where the results of one study or fit go."""
        return self.invocation.out / name

    def checkpoint(self, name: str) -> Path:
        """Return where a run keeps what it has finished."""
        return self.invocation.out / f"{name}.partial"

    def run(self, study: "StatedStudy", sample: bool = False) -> "Run":
        """Run one study or fit; where `stop` is true it stops early and is marked `interrupted`.

        `sample`: whether the posterior of a fit is sampled by MCMC.
        """
        from needlefit.studies.job import Settings, run_study
        from needlefit.studies.run import store_sources

        asked = self.invocation
        with show_progress(asked.quiet) as report:
            settings = Settings(
                seed=asked.seed,
                jobs=asked.jobs or count_cores(),
                pool=self.pool,
                checkpoint=self.checkpoint(study.name),
                resume=asked.resume,
                sample=sample,
                progress=report,
                stop=self.stop,
                first=no_note if asked.quiet else print_remark,
                note=self._print_note,
            )
            run = run_study(study, settings)
        sources = store_sources(self.sources.get(study.name, ()), self.folder(study.name))
        return replace(run, timing={**run.timing, **sources})

    def run_kind(self, kind: str, name: str, inputs: "Inputs", **options: object) -> "Run":
        """Run the study of a kind that options describe, and write its folder; `inputs` stand for its files.

        An interrupted one ends the command.
        """
        from needlefit.studies.job import StatedStudy
        from needlefit.studies.kind import find_kind

        run = self.run(StatedStudy(name, find_kind(kind).make_record(**options), inputs))
        if run.interrupted:
            raise self.interrupted()
        self.write(run)
        self.remove_checkpoint(name)
        return run

    def write(self, run: "Run") -> Path:
        from needlefit.studies.report import write_run

        with show_progress(self.invocation.quiet) as report:
            report(f"{run.name}: tables, figures and report", 0, 1)
            return write_run(run, self.folder(run.name))

    def write_reference(self, runs: "Iterable[Run]") -> None:
        """Write the reference results of runs, if wanted: their tables, rounded."""
        from needlefit.studies.report import write_reference

        for run in runs if self.invocation.reference else ():
            screen.print_written(write_reference(run, self.folder(f"reference/{run.name}")))

    def remove_checkpoint(self, name: str) -> None:
        """Remove the checkpoint of a run that is complete."""
        from needlefit.project.checkpoint import remove_checkpoint

        remove_checkpoint(self.checkpoint(name), print_remark)

    def _print_note(self, line: str) -> None:
        self.invocation.noted.append(line)
        print_remark(line)

    def interrupted(self) -> typer.Exit:
        """Say how to go on; return the exit to raise."""
        screen.print_note(self.invocation.interrupt_message())
        return typer.Exit(exit_codes.INTERRUPTED)


@contextmanager
def begin(context: typer.Context) -> Iterator[Execution]:
    """Yield the execution of a command that Ctrl-C stops with what is finished.

    Commands import what they need inside of it, so that Ctrl-C never cuts an import in two.
    """
    invocation = context.find_root().obj
    invocation.resumes = "resume" in context.params
    with catch_interrupts(invocation) as stop:
        leave_out_help_texts()
        yield Execution(invocation, stop)


@contextmanager
def open_pool(asked: Invocation, usual: int) -> "Iterator[TaskPool]":
    """Open the pool that the options name: processes (`usual`: how many at most, where nothing is stated), or
    the workers of a cluster.
    """
    from needlefit.project.tasks import LocalPool

    if asked.scheduler is None:
        yield LocalPool(asked.jobs or min(usual, count_cores()))
        return
    from needlefit.project.cluster import connect_cluster

    with connect_cluster(asked.scheduler, asked.insecure, print_remark) as pool:
        yield pool


def print_remark(line: str) -> None:
    """Print a line about what was found on the way, that is no result, to stderr."""
    screen.print_note(f"needlefit: {line}")


def require_no_faults(faults: Iterable[str]) -> None:
    """Say all faults and end with the exit code of what did not converge, if there is one.

    Faults of a run are a scored simulation, a search or a posterior that did not converge. The results are
    written by then, marked.
    """
    listed = list(faults)
    for fault in listed:
        screen.print_note(f"needlefit: {fault}")
    if listed:
        raise typer.Exit(exit_codes.NOT_CONVERGED)


_WRITING = threading.Lock()  # lock of reports: what draws and compiles them serves one thread at a time


def _run_study(
    execution: Execution, datasets: "Mapping[Path, Dataset]", work: "StatedStudy"
) -> "tuple[Run, list[str]]":
    """Run and write a study; it may do so in a thread or a copy. An interrupted one is not written.

    `datasets`: by the files or folders that studies name. Also returns the notes that were printed.
    """
    from needlefit.project.toml import find_named
    from needlefit.schemas.study import FitRecord, StudyRecord
    from needlefit.studies.job import Inputs

    noted = list[str]()
    if isinstance(work.record, FitRecord):
        dataset = datasets[find_named("dataset", work.record.dataset)]
        work = replace(work, inputs=Inputs(dataset=dataset))
    execution = replace(execution, invocation=replace(execution.invocation, noted=noted))
    # a fit by itself is sampled as by `tune`; folds of studies are not
    run = execution.run(work, sample=not isinstance(work.record, StudyRecord))
    if not run.interrupted:
        with _WRITING:
            execution.write(run)
    return run, noted


def _estimate_size(datasets: "Mapping[Path, Dataset]", work: "StatedStudy") -> tuple[bool, int]:
    """Return what orders studies by how long they take: whether they are sampled, and how many needles."""
    from needlefit.datasets.folds import make_folds
    from needlefit.project.toml import add_file_context, find_named
    from needlefit.schemas.study import FitRecord, StudyRecord

    if not isinstance(work.record, FitRecord):
        return False, 0
    with add_file_context(work.file):
        folds = make_folds(work.record, datasets[find_named("dataset", work.record.dataset)])
    needles = sum(len(fold.tune) + len(fold.validate) for fold in folds)
    return not isinstance(work.record, StudyRecord), needles


def _run_side_by_side(
    execution: Execution, todo: "Sequence[StatedStudy]", datasets: "Mapping[Path, Dataset]"
) -> "Iterator[tuple[int, tuple[Run, list[str]]]]":
    """Yield the number of each study and what `_run_study` returns, as they are finished.

    They run in as many copies of this process as there are jobs, or in threads that wait for the workers of a
    cluster.
    """
    from needlefit.project.tasks import LocalPool, TaskStop, can_fork, run_parts, stop_requested

    asked, stop, order = execution.invocation, TaskStop(execution.stop), list(range(len(todo)))
    with open_pool(asked, count_cores()) as pool:
        if isinstance(pool, LocalPool):
            processes = min(pool.size, len(todo)) if can_fork() else 1
            if processes > 1:
                print_remark(f"{len(todo)} runs in {processes} processes")
                alone = replace(asked, jobs=math.ceil(pool.size / processes), quiet=True)  # no core is idle
                execution = replace(execution, invocation=alone, stop=stop_requested)
                # the shortest ones last, so that all processes end together
                order.sort(key=lambda number: _estimate_size(datasets, todo[number]), reverse=True)
            runner = partial(_run_study, execution, datasets)
            for place, result in LocalPool(processes).run(runner, [todo[number] for number in order], stop):
                yield order[place], result
            return
        alone = replace(asked, jobs=1, quiet=asked.quiet or len(todo) > 1)
        sending = replace(execution, invocation=alone, stop=stop, pool=pool)

        def run_in_thread(work: "StatedStudy") -> "tuple[Run, list[str]]":
            try:
                return _run_study(sending, datasets, work)
            except BaseException:
                stop.leave()  # nobody wants the others
                raise

        yield from run_parts(run_in_thread, todo, len(todo))


def run_studies(execution: Execution, todo: "Sequence[StatedStudy]") -> "list[Run]":
    """Run, write and print every work; their checkpoints stay. A dataset is read once for all.

    Several run side by side; the results are the same.
    """
    from needlefit.datasets.read import read
    from needlefit.project.toml import add_file_context, find_named
    from needlefit.schemas.study import FitRecord

    datasets: dict[Path, Dataset] = {}
    for work in todo:
        if isinstance(work.record, FitRecord):
            with add_file_context(work.file):
                path = find_named("dataset", work.record.dataset)
                datasets[path] = datasets.get(path) or read(path)
    asked, finished, done = execution.invocation, dict[int, "Run"](), list["Run"]()
    for number, (run, noted) in _run_side_by_side(execution, todo, datasets):
        if run.interrupted:
            break
        asked.noted += noted
        finished[number] = run
        while len(done) in finished:  # in their order
            done.append(finished[len(done)])
            show_run(asked, done[-1], execution.folder(done[-1].name), named=len(todo) > 1)
            if len(todo) > 1 and not asked.json:
                screen.print_line()
    if len(done) < len(todo):
        raise execution.interrupted()
    return done


#: how a terminal shows the beginning of an answer, by its status
STATUS_STYLES = {"none": "bold", "pass": "bold green", "warn": "bold yellow", "fail": "bold red"}


def show_run(
    invocation: Invocation, run: "Run", folder: Path, named: bool = False, results: Path | None = None
) -> None:
    """Print the first page of a study, the answer first, the method last; with `--explain` all tables.

    `named`: before the answer stands the name of the run. `results`: the folder that holds the folders of
    results, where it is not that of `folder`. With `--json` its warnings are printed alone.
    """
    if invocation.json:
        show_warnings(invocation, run)
        return
    from needlefit.reporting.table import drop_repeated
    from needlefit.studies.first_page import METHOD, lay_out_checks, summarize_checks
    from needlefit.studies.report import find_report

    page, head = run.first_page, f"{run.name}: " if named else ""
    opening = len(head + page.answer) - len(page.verdict.sentence) - 1 + len(page.verdict.opening)
    screen.print_text(head + page.answer, STATUS_STYLES[page.verdict.status], opening)
    screen.print_text(page.about)
    show_warnings(invocation, run)
    for number, table in enumerate(page.tables):
        if number:
            screen.print_line()
        screen.show_display(replace(table, breaks=()), notes=False)
    if page.checks:
        screen.print_text(summarize_checks(page.checks))
    if page.advice is not None:
        show_advice(page.advice, results or folder.parent)
    if page.method:
        screen.print_text(f"{METHOD} {page.method}")
    if invocation.explain:
        shown = {table.name for table in page.tables}
        further = [table for table in find_report(run).lay_out(run) if table.name not in shown]
        for table in drop_repeated([lay_out_checks(page.checks), *further]):
            screen.print_line()
            screen.show_display(table)
    documents = [name for name in ("report.html", "report.pdf") if (folder / name).is_file()]
    screen.print_written(folder, f" ({', '.join(documents)})" if documents else "")


def show_advice(advice: "Advice", results: Path) -> None:
    """Print what to do, and under it the command, on a line of its own to be copied whole.

    `results`: the folder that holds the folders of results.
    """
    from needlefit.studies.first_page import WHAT_TO_DO

    screen.print_text(f"{WHAT_TO_DO} {advice.sentence}")
    if advice.command:
        screen.print_line(f"  {advice.format_command(results)}")


def show_next_steps(dataset: "Dataset", folder: Path) -> None:
    """Print the commands that follow on a new dataset in `folder` with first studies or fits."""
    from needlefit.datasets.first_study import list_first_runs

    path = format_path(folder)
    for first_run in list_first_runs(dataset):
        run, scene = f"{path}/{first_run.file}", f"{path}/{first_run.scene_file}"
        of_medium = f" of {first_run.medium}" if first_run.medium else ""
        if not first_run.leave_out:
            held_out = (
                f"one needle{of_medium}"
                if len(first_run.insertions) == 1
                else "a specimen for each run (specimen=NAME if all went into one)"
            )
            screen.print_note(f"{held_out}: nothing is held out, no verdict is possible")
        screen.print_note(f"stiffness and bevel{of_medium}: {shlex.join(('needlefit', 'tune', run))}")
        if first_run.leave_out:
            screen.print_note(f"a first study{of_medium}: {shlex.join(('needlefit', 'validate', run))}")
        predict = shlex.join(("needlefit", "predict", run, "--scene", scene))
        screen.print_note(f"then a prediction{of_medium}: {predict}")


def show_result(execution: Execution, run: "Run", more: dict[str, object] | None = None) -> None:
    """Print a result: in words, or as JSON with `more` keys, with warnings on stderr."""
    if execution.invocation.json:
        show_json_of([run], more)
    show_run(execution.invocation, run, execution.folder(run.name))


def show_json_of(runs: "Sequence[Run]", more: dict[str, object] | None = None) -> None:
    """Print one result as JSON, with `more` keys, or several by name."""
    from needlefit.studies.report import run_to_json

    results = {run.name: run_to_json(run) | (more or {}) for run in runs}
    screen.show_json(next(iter(results.values())) if len(results) == 1 else results)


def show_warnings(invocation: Invocation, run: "Run") -> None:
    """Print the warnings of a run to stderr, with the paths of the files that they are about."""
    data, located = Path(run.timing.get("dataset", "")).parent, []
    for warning in run.warnings:
        if warning.kind == "data_changed":  # its file is none of those that the run used
            if any(warning.what in line for line in invocation.noted):
                invocation.warned = True
            else:
                located.append(warning)
            continue
        file = re.sub(r"(:\d+)?(, key .*)?$", "", warning.where)
        is_there = (data / file).is_file()
        located.append(replace(warning, where=str(data / warning.where)) if is_there else warning)
    screen.print_warnings(invocation, located)
