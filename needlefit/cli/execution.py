"""Settings of a run: options, progress, and the folders of results and checkpoints."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from needlefit.cli import exit_codes, screen
from needlefit.cli.exit_codes import Invocation
from needlefit.cli.progress import show_progress
from needlefit.errors import ConfigError
from needlefit.project.processes import count_cores

if TYPE_CHECKING:
    from needlefit.project.progress import Progress
    from needlefit.project.tasks import TaskPool
    from needlefit.schemas.base import FileRecord
    from needlefit.studies.job import Settings
    from needlefit.studies.run import Run


@dataclass(frozen=True)
class Execution:
    """What the options say about a run; results go to `out/<name>/`, checkpoints to `out/<name>.partial/`.

    `file` is the study's, where it is known: warnings name it. `pool` is where tasks run; None: in
    processes of each run.
    """

    invocation: Invocation
    out: Path
    seed: int | None
    jobs: int | None
    resume: bool
    stop: Callable[[], bool]
    sample: bool = False
    file: Path | None = None
    pool: "TaskPool | None" = None

    def prepare(self, names: Iterable[str], replaces_posterior: bool = False) -> None:
        """Make sure, before hours of work, that the results can be written.

        `replaces_posterior` says that these runs sample a posterior whatever the options say.

        Raises
        ------
        ConfigError
            If they cannot, or would replace something that needlefit did not write.
        """
        from needlefit.project.checkpoint import require_own_checkpoint
        from needlefit.project.manifest import require_replaceable

        for name in names:
            require_replaceable(self.folder(name))
            require_own_checkpoint(self.checkpoint(name))
            if not (self.sample or replaces_posterior) and any(self.folder(name).glob("posterior*.nc")):
                raise ConfigError(
                    "holds a sampled posterior, which this run would replace by none",
                    where=str(self.folder(name)),
                    fix="sample again with --sample, write elsewhere with --out, or remove it",
                )

    def folder(self, name: str) -> Path:
        """Return where the results of one study or fit go."""
        return self.out / name

    def checkpoint(self, name: str) -> Path:
        """Return where a run keeps what it has finished."""
        return self.out / f"{name}.partial"

    def run(self, name: str, record: "FileRecord") -> "Run":
        """Run one study or fit; where `stop` says so it stops early and is marked `interrupted`."""
        from needlefit.studies.kind import kind_of

        opened = open_pool(self.jobs, None, False) if self.pool is None else nullcontext(self.pool)
        with show_progress(self.invocation.quiet) as report, opened as pool:
            return kind_of(record).run(name, record, self._settings(name, report, pool))

    def run_and_write(self, name: str, record: "FileRecord") -> "Run":
        """Run one study and write its folder; an interrupted one ends the command."""
        result = self.run(name, record)
        if result.interrupted:
            raise self.interrupted()
        self.write(result)
        return result

    def _settings(self, name: str, report: "Progress", pool: "TaskPool") -> "Settings":
        from needlefit.studies.job import Settings

        return Settings(
            seed=self.seed,
            jobs=self.jobs or count_cores(),
            pool=pool,
            checkpoint=self.checkpoint(name),
            resume=self.resume,
            sample=self.sample,
            progress=report,
            stop=self.stop,
            note=print_remark,
            file=self.file,
        )

    def write(self, result: "Run") -> Path:
        """Write a run; return its folder."""
        from needlefit.studies.report import write_run

        return write_run(result, self.folder(result.name))

    def prepare_reference(self, names: Iterable[str]) -> None:
        """Make sure that the reference results of runs can be written; ConfigError as of `prepare`."""
        self.prepare([f"reference/{name}" for name in names], replaces_posterior=True)

    def write_reference(self, runs: "Iterable[Run]") -> None:
        """Write the reference results of runs: their tables, rounded."""
        from needlefit.studies.reference import write_reference

        for one in runs:
            screen.print_line(f"written: {write_reference(one, self.folder(f'reference/{one.name}'))}/")

    def remove_checkpoint(self, name: str) -> None:
        """Remove the checkpoint of a run that is complete."""
        from needlefit.project.checkpoint import remove_checkpoint

        remove_checkpoint(self.checkpoint(name), print_remark)

    def interrupted(self) -> typer.Exit:
        """Say how to go on; return the exit to raise."""
        screen.print_note(self.invocation.interrupt_message())
        return typer.Exit(exit_codes.INTERRUPTED)


@contextmanager
def open_pool(jobs: int | None, scheduler: str | None, insecure: bool) -> "Iterator[TaskPool]":
    """Open the pool that the options name: `jobs` processes (a core each), or the workers of a cluster."""
    from needlefit.project.tasks import LocalPool

    if scheduler is None:
        yield LocalPool(jobs or count_cores())
        return
    from needlefit.project.cluster import connect

    with connect(scheduler, insecure, print_remark) as pool:
        yield pool


def print_remark(line: str) -> None:
    """Print a line about what was found on the way, that is no result, to stderr."""
    screen.print_note(f"needlefit: {line}")


def require_converged(results: "Run") -> None:
    """End with its exit code if a scored simulation of the fit, its search, or a posterior did not converge.

    The results are written by then, marked.
    """
    require_no_faults(f"{results.name}: {fault}" for fault in results.faults)


def require_no_faults(faults: Iterable[str]) -> None:
    """Say all faults and end with the exit code of what did not converge, if there is one."""
    listed = list(faults)
    for fault in listed:
        screen.print_note(f"needlefit: {fault}")
    if listed:
        raise typer.Exit(exit_codes.NOT_CONVERGED)
