"""Run the studies that a name means, one after the other; write and print their results."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from needlefit.cli import screen
from needlefit.cli.execution import Execution, list_faults
from needlefit.cli.screen import print_run_warnings
from needlefit.cli.show_results import show_validation
from needlefit.project.load import load
from needlefit.project.locate import EVERY_STUDY, find_studies, find_tunings
from needlefit.project.result_warnings import WARNINGS_KEY, read_warnings, to_rows
from needlefit.project.toml_lines import add_file_context
from needlefit.schemas.analyses import AnalysisRecord
from needlefit.schemas.study import FitRecord, StudyRecord, TrackStudyRecord
from needlefit.validation.analyses.runner import AnalysisResult
from needlefit.validation.results import Results
from needlefit.validation.studies import AnyStudy, find_missing_data, load_study
from needlefit.validation.tracks.results import TrackResults


@dataclass(frozen=True)
class StudyTask:
    """A study, or a fit of the paper's tuning tables, that is to be carried out."""

    name: str
    record: AnyStudy | FitRecord
    file: Path

    @property
    def sampled(self) -> bool:
        """Whether it samples a posterior whatever the options say."""
        return isinstance(self.record, TrackStudyRecord)


@dataclass(frozen=True)
class StudyOutcomes:
    """What came of them, in their order."""

    scored: list[Results] = field(default_factory=list)
    tuned: list[Results] = field(default_factory=list)
    analyses: list[AnalysisResult] = field(default_factory=list)
    tracks: list[TrackResults] = field(default_factory=list)

    def faults(self) -> list[str]:
        """Return why something in them is not to be trusted."""
        faults = [fault for results in (*self.scored, *self.tuned) for fault in list_faults(results)]
        others = {one.name: one.faults for one in self.analyses} | {
            one.name: one.faults for one in self.tracks
        }
        return [*faults, *(f"{name}: {fault}" for name, found in others.items() for fault in found)]

    def as_json(self) -> object:
        """Return the answers as plain values: of a single sort as they are, else by study."""
        from needlefit.reporting.tables import tabulate_validation, to_records

        warned = {one.name: to_rows(read_warnings(one.run)) for one in self.scored}
        rows = [(one.name, row) for one in self.scored for row in to_records(tabulate_validation(one))]
        table = [{**row, WARNINGS_KEY: warned[name]} for name, row in rows]
        others: dict[str, object] = {one.name: analysis_json(one) for one in self.analyses}
        others |= {one.name: tracks_json(one) for one in self.tracks}
        if not others:
            return table
        alone = len(others) == 1 and not table
        return next(iter(others.values())) if alone else {"validation": table, **others}

    def write_reference(self, folder: Path) -> None:
        """Write the evidence of all of them to `find_cache_folder`."""
        from needlefit.reporting.reference import write_reference

        every: list[Results | AnalysisResult | TrackResults] = [*self.scored, *self.tuned]
        for one in [*every, *self.analyses, *self.tracks]:
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
            _run_study(replace(execution, file=work.file), work, done, json)
    return done


def _run_study(execution: Execution, work: StudyTask, done: StudyOutcomes, json: bool) -> None:
    if isinstance(work.record, AnalysisRecord):
        done.analyses.append(run_analysis(execution, work.name, work.record, json))
    elif isinstance(work.record, TrackStudyRecord):
        done.tracks.append(run_tracks(execution, work.name, work.record, json))
    else:
        results = _run_fit(execution, work.name, work.record, json)
        (done.scored if isinstance(work.record, StudyRecord) else done.tuned).append(results)


def _run_fit(execution: Execution, name: str, record: StudyRecord | FitRecord, json: bool) -> Results:
    results = execution.run(name, record)
    if results.interrupted:
        raise execution.interrupted()
    written = execution.write(results)
    if not json:
        show_validation(results)
        screen.print_line(f"written: {written}/")
    print_run_warnings(execution.invocation, results.run, results.timing.get("dataset", ""))
    if not json:
        screen.print_line()
    return results


def run_analysis(execution: Execution, name: str, record: "AnalysisRecord", json: bool) -> "AnalysisResult":
    """Run, write and print one analysis."""
    from needlefit.reporting.analyses.result_folder import write_analysis

    answer = execution.run_analysis(name, record)
    if answer.interrupted:
        raise execution.interrupted()
    folder = write_analysis(answer, execution.folder(name))
    if not json:
        _show_analysis(answer)
        screen.print_line(f"written: {folder}/")
    print_run_warnings(execution.invocation, answer.run)
    if not json:
        screen.print_line()
    return answer


def analysis_json(answer: "AnalysisResult") -> dict[str, object]:
    """Return the frames of an answer as plain values."""
    from needlefit.reporting.tables import to_records

    warnings = to_rows(read_warnings(answer.run))
    return {**{name: to_records(frame) for name, frame in answer.frames.items()}, WARNINGS_KEY: warnings}


def _show_analysis(answer: "AnalysisResult") -> None:
    from needlefit.reporting.analyses.result_folder import ANALYSIS_PAGES

    page = ANALYSIS_PAGES[answer.kind]
    screen.print_line(f"{answer.name}: {answer.title}")
    kind = "SYNTHETIC" if answer.synthetic else "measured"
    screen.print_line(f"  {kind} data: {answer.dataset_title}")
    for table in page.lay_out(answer):
        screen.show_display(table)
    for sentence in page.summarize(answer):
        screen.print_line(sentence)


def run_tracks(execution: Execution, name: str, record: "TrackStudyRecord", json: bool) -> "TrackResults":
    """Run, write and print one study of tip tracks; predictions use its posterior."""
    from needlefit.reporting.track_report import write_tracks

    results = replace(execution, sample=True).run_tracks(name, record)
    if results.interrupted:
        raise execution.interrupted()
    folder = write_tracks(results, execution.folder(name))
    if not json:
        _show_tracks(results, folder)
    print_run_warnings(execution.invocation, results.run, results.timing.get("dataset", ""))
    return results


def tracks_json(results: "TrackResults") -> object:
    """Return how methods compare, run by run, as plain values."""
    from needlefit.reporting.tables import to_records
    from needlefit.validation.tracks.results import compare_methods_by_run

    warnings = to_rows(read_warnings(results.run))
    return [{**row, WARNINGS_KEY: warnings} for row in to_records(compare_methods_by_run(results))]


def _show_tracks(results: "TrackResults", folder: Path) -> None:
    from needlefit.reporting.track_report import (
        lay_out_coverage,
        lay_out_depths,
        lay_out_parameters,
        lay_out_scores,
        list_cautions,
        summarize_tracks,
    )

    screen.print_line(f"{results.name}: {results.title}")
    kind = "SYNTHETIC" if results.origin == "synthetic" else "measured"
    for sentence in (f"{kind} data: {results.dataset_title}", *list_cautions(results)):
        screen.print_line(f"  {sentence}")
    for layout in (lay_out_parameters, lay_out_scores, lay_out_depths, lay_out_coverage):
        screen.show_display(layout(results))
    for sentence in summarize_tracks(results):
        screen.print_line(sentence)
    screen.print_line(f"written: {folder}/")
