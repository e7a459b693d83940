"""Run the studies that a name means, one after the other; write and print their results."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from needlefit.cli import screen
from needlefit.cli.execution import Execution
from needlefit.cli.show_results import show_run, show_warnings
from needlefit.project.load import load
from needlefit.project.locate import EVERY_STUDY, find_studies, find_tunings
from needlefit.project.toml_lines import add_file_context
from needlefit.schemas.base import FileRecord
from needlefit.schemas.study import FitRecord
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

    def write_reference(self, folder: Path) -> None:
        """Write the evidence of all of them to `folder`."""
        from needlefit.studies.reference import write_reference

        for one in self.runs:
            screen.print_line(f"written: {write_reference(one, folder / one.name)}/")


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
    for work in todo:
        with add_file_context(work.file):
            done.runs.append(_run(replace(execution, file=work.file), work, json, len(todo) > 1))
    return done


def _run(execution: Execution, work: StudyTask, json: bool, named: bool) -> Run:
    """Run, write and print one study."""
    result = execution.run(work.name, work.record)
    if result.interrupted:
        raise execution.interrupted()
    folder = execution.write(result)
    if json:
        show_warnings(execution.invocation, result)
    else:
        show_run(execution.invocation, result, folder, named)
    if named and not json:
        screen.print_line()
    return result
