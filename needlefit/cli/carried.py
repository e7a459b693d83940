"""The studies that a name means, carried out one after the other, each by its own verb."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from needlefit.cli import screen, validate_inquiry, validate_tracks
from needlefit.cli.execution import Execution, faults_of
from needlefit.cli.show_validation import show_validation
from needlefit.cli.warn import warn_of
from needlefit.project.load import load
from needlefit.project.places import EVERYTHING, find_studies, find_tunings
from needlefit.project.records.fit import FitRecord
from needlefit.project.records.inquiry import InquiryRecord
from needlefit.project.records.study import StudyRecord
from needlefit.project.records.track_study import TrackStudyRecord
from needlefit.project.result_warnings import KEY, as_rows, warnings_of
from needlefit.project.toml_lines import in_file
from needlefit.validation.inquiries.answer import Answer
from needlefit.validation.results import Results
from needlefit.validation.studies import AnyStudy, lacking_data, load_study
from needlefit.validation.tracks.results import TrackResults


@dataclass(frozen=True)
class Work:
    """A study, or a fit of the paper's tuning tables, that is to be carried out."""

    name: str
    record: AnyStudy | FitRecord
    file: Path

    @property
    def sampled(self) -> bool:
        """Whether it samples a posterior whatever the options say."""
        return isinstance(self.record, TrackStudyRecord)


@dataclass(frozen=True)
class Carried:
    """What came of them, in their order."""

    scored: list[Results] = field(default_factory=list)
    tuned: list[Results] = field(default_factory=list)
    answers: list[Answer] = field(default_factory=list)
    tracks: list[TrackResults] = field(default_factory=list)

    def faults(self) -> list[str]:
        """Return why something in them is not to be trusted."""
        faults = [fault for results in (*self.scored, *self.tuned) for fault in faults_of(results)]
        others = {one.name: one.faults for one in self.answers} | {
            one.name: one.faults for one in self.tracks
        }
        return [*faults, *(f"{name}: {fault}" for name, found in others.items() for fault in found)]

    def as_json(self) -> object:
        """Return the answers as plain values: of a single sort as they are, else by study."""
        from needlefit.reporting.tables import records, validation_table

        warned = {one.name: as_rows(warnings_of(one.run)) for one in self.scored}
        rows = [(one.name, row) for one in self.scored for row in records(validation_table(one))]
        table = [{**row, KEY: warned[name]} for name, row in rows]
        others: dict[str, object] = {one.name: validate_inquiry.as_json(one) for one in self.answers}
        others |= {one.name: validate_tracks.as_json(one) for one in self.tracks}
        if not others:
            return table
        alone = len(others) == 1 and not table
        return next(iter(others.values())) if alone else {"validation": table, **others}

    def write_reference(self, folder: Path) -> None:
        """Write the evidence of all of them to `folder`."""
        from needlefit.reporting.reference import write_reference

        every: list[Results | Answer | TrackResults] = [*self.scored, *self.tuned]
        for one in [*every, *self.answers, *self.tracks]:
            screen.say(f"written: {write_reference(one, folder / one.name)}/")


def works(study: str) -> list[Work]:
    """Return what a name means; of `everything`, what lacks its data is left out and said.

    Raises
    ------
    ConfigError
        If there is no such study, or its file does not hold what its kind wants.
    """
    found = []
    for name, path in find_studies(study):
        missing = lacking_data(path) if study == EVERYTHING else []
        if missing:
            screen.note(f"needlefit: {name} is left out: the data of {', '.join(missing)} are not here")
        else:
            found.append(Work(name, load_study(path), path))
    return [*found, *(Work(name, load(path, FitRecord), path) for name, path in find_tunings(study))]


def carry_out(execution: Execution, todo: Sequence[Work], json: bool) -> Carried:
    """Run, write and print every work; their checkpoints stay."""
    done = Carried()
    for work in todo:
        with in_file(work.file):
            _carry_out(replace(execution, file=work.file), work, done, json)
    return done


def _carry_out(execution: Execution, work: Work, done: Carried, json: bool) -> None:
    if isinstance(work.record, InquiryRecord):
        done.answers.append(validate_inquiry.ask(execution, work.name, work.record, json))
    elif isinstance(work.record, TrackStudyRecord):
        done.tracks.append(validate_tracks.run_tracks(execution, work.name, work.record, json))
    else:
        results = _run(execution, work.name, work.record, json)
        (done.scored if isinstance(work.record, StudyRecord) else done.tuned).append(results)


def _run(execution: Execution, name: str, record: StudyRecord | FitRecord, json: bool) -> Results:
    results = execution.run(name, record)
    if results.interrupted:
        raise execution.interrupted()
    written = execution.write(results)
    if not json:
        show_validation(results)
        screen.say(f"written: {written}/")
    warn_of(execution.invocation, results.run, results.timing.get("dataset", ""))
    if not json:
        screen.say()
    return results
