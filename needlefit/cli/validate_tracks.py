"""`needlefit validate` of a study of tip tracks."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from needlefit.cli import screen
from needlefit.cli.execution import Execution
from needlefit.cli.warn import warn_of
from needlefit.project.result_warnings import KEY, as_rows, warnings_of

if TYPE_CHECKING:
    from needlefit.project.records.track_study import TrackStudyRecord
    from needlefit.validation.tracks.results import TrackResults


def run_tracks(execution: Execution, name: str, record: "TrackStudyRecord", json: bool) -> "TrackResults":
    """Run, write and print one study of tip tracks; what is foretold is made of its posterior."""
    from needlefit.reporting.tracks.write import write_tracks

    results = replace(execution, sample=True).run_tracks(name, record)
    if results.interrupted:
        raise execution.interrupted()
    folder = write_tracks(results, execution.folder(name))
    if not json:
        _show(results, folder)
    warn_of(execution.invocation, results.run, results.timing.get("dataset", ""))
    return results


def as_json(results: "TrackResults") -> object:
    """Return how rivals compare, run by run, as plain values."""
    from needlefit.reporting.tables import records
    from needlefit.validation.tracks.summary import paired_runs

    warnings = as_rows(warnings_of(results.run))
    return [{**row, KEY: warnings} for row in records(paired_runs(results))]


def _show(results: "TrackResults", folder: Path) -> None:
    from needlefit.reporting.tracks.layouts import (
        coverage_layout,
        depths_layout,
        parameters_layout,
        scores_layout,
    )
    from needlefit.reporting.tracks.said import cautions, in_short

    screen.say(f"{results.name}: {results.title}")
    kind = "SYNTHETIC" if results.origin == "synthetic" else "measured"
    for sentence in (f"{kind} data: {results.dataset_title}", *cautions(results)):
        screen.say(f"  {sentence}")
    for layout in (parameters_layout, scores_layout, depths_layout, coverage_layout):
        screen.show_display(layout(results))
    for sentence in in_short(results):
        screen.say(sentence)
    screen.say(f"written: {folder}/")
