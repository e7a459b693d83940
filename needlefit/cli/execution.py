"""Settings of a run: options, progress, and the folders of results and checkpoints."""

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from needlefit.cli import exit_codes, screen
from needlefit.cli.exit_codes import Invocation
from needlefit.cli.progress import show_progress
from needlefit.errors import ConfigError

if TYPE_CHECKING:
    from needlefit.project.progress import Progress
    from needlefit.schemas.analyses import AnalysisRecord
    from needlefit.schemas.study import FitRecord, StudyRecord, TrackStudyRecord
    from needlefit.validation.analyses.runner import AnalysisResult
    from needlefit.validation.job import Settings
    from needlefit.validation.results import Results
    from needlefit.validation.tracks.results import TrackResults


@dataclass(frozen=True)
class Execution:
    """What the options say about a run; results go to `out/<name>/`, checkpoints to `out/<name>.partial/`.

    `file` is the study's, where it is known: warnings name it.
    """

    invocation: Invocation
    out: Path
    seed: int | None
    jobs: int | None
    resume: bool
    stop: Callable[[], bool]
    sample: bool = False
    file: Path | None = None

    def prepare(self, names: Iterable[str], replaces_posterior: bool = False) -> None:
        """Make sure, before hours of work, that the results can be written.

        `replaces_posterior` says that these runs sample a posterior whatever the options say.

        Raises
        ------
        ConfigError
            If they cannot, or would replace something that needlefit did not write.
        """
        from needlefit.project.ownership import require_own_checkpoint, require_replaceable

        for name in names:
            require_replaceable(self.folder(name))
            require_own_checkpoint(self.checkpoint(name))
            if not (self.sample or replaces_posterior) and any(self.folder(name).glob("posterior*.nc")):
                raise ConfigError(
                    "holds a sampled posterior, which this run would replace by none",
                    where=str(self.folder(name)),
                    fix="sample again with --sample, write elsewhere with --out, or remove it",
                )
        screen.compile_ahead("lanes", "sensitivity", quiet=self.invocation.quiet)

    def folder(self, name: str) -> Path:
        """Return where the results of one study or fit go."""
        return self.out / name

    def checkpoint(self, name: str) -> Path:
        """Return where a run keeps what it has finished."""
        return self.out / f"{name}.partial"

    def run(self, name: str, record: "StudyRecord | FitRecord") -> "Results":
        """Run one study or fit; where `stop` says so it stops early and is marked `interrupted`."""
        from needlefit.validation.run import run

        with show_progress(self.invocation.quiet) as report:
            return run(name, record, self._settings(name, report))

    def run_tracks(self, name: str, record: "TrackStudyRecord") -> "TrackResults":
        """Run one study of tip tracks; else as `run`."""
        from needlefit.validation.tracks.run import run

        with show_progress(self.invocation.quiet) as report:
            return run(name, record, self._settings(name, report))

    def run_analysis(self, name: str, record: "AnalysisRecord") -> "AnalysisResult":
        """Run one analysis; else as `run`."""
        from needlefit.validation.analyses.kinds import run

        with show_progress(self.invocation.quiet) as report:
            return run(name, record, self._settings(name, report))

    def _settings(self, name: str, report: "Progress") -> "Settings":
        from needlefit.validation.job import Settings

        return Settings(
            seed=self.seed,
            jobs=self.jobs or count_cores(),
            checkpoint=self.checkpoint(name),
            resume=self.resume,
            sample=self.sample,
            progress=report,
            stop=self.stop,
            note=print_remark,
            file=self.file,
        )

    def write(self, results: "Results") -> Path:
        """Write the results; return their folder."""
        from needlefit.reporting.posterior import make_posterior_writers
        from needlefit.reporting.run_folder import write

        folder = self.folder(results.name)
        write(results, folder, make_posterior_writers(results))
        return folder

    def remove_checkpoint(self, name: str) -> None:
        """Remove the checkpoint of a run that is complete."""
        from needlefit.project.checkpoint_folder import remove_checkpoint

        remove_checkpoint(self.checkpoint(name), print_remark)

    def interrupted(self) -> typer.Exit:
        """Say how to go on; return the exit to raise."""
        screen.print_note(f"needlefit: interrupted; to go on: {self.invocation.resuming()}")
        return typer.Exit(exit_codes.INTERRUPTED)


def print_remark(line: str) -> None:
    """Print a line about what was found on the way, that is no result, to stderr."""
    screen.print_note(f"needlefit: {line}")


def count_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def require_converged(results: "Results") -> None:
    """End with its exit code if a scored simulation of the fit, its search, or a posterior did not converge.

    The results are written by then, marked.
    """
    require_no_faults(list_faults(results))


def list_faults(results: "Results") -> list[str]:
    """Return what did not converge: scored simulations of the fit, its search, a posterior."""
    fitted = results.errors[results.errors["method"] == "fitted"]
    failed = int((~fitted["converged"].astype(bool)).sum())
    faults = [f"{failed} of {len(fitted)} simulations of the fit did not converge"] if failed else []
    for fold, found in results.run.get("search_faults", {}).items():
        faults += [fault if fold == "all" else f"{fold}: {fault}" for fault in found]
    for posterior in results.posteriors.values():
        faults += [f"the posterior has not converged: {why}" for why in posterior.faults]
    return [f"{results.name}: {fault}" for fault in faults]


def require_no_faults(faults: Iterable[str]) -> None:
    """Say all faults and end with the exit code of what did not converge, if there is one."""
    listed = list(faults)
    for fault in listed:
        screen.print_note(f"needlefit: {fault}")
    if listed:
        raise typer.Exit(exit_codes.NOT_CONVERGED)
