"""`needlefit validate` of a study of tip tracks."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from needlefit.cli import failure, screen
from needlefit.cli.execution import Execution

if TYPE_CHECKING:
    from needlefit.validation.tracks.results import TrackResults


def observes_tracks(path: Path) -> bool:
    """Return whether the study in a file is one of tip tracks."""
    from needlefit.project.load import read_toml

    return "observes" in read_toml(path)


def validate_tracks(execution: Execution, name: str, path: Path, json: bool) -> None:
    """Run, write and print one study of tip tracks."""
    from needlefit.project.load import load
    from needlefit.project.records.track_study import TrackStudyRecord
    from needlefit.reporting.tracks.write import write_tracks

    record, execution = load(path, TrackStudyRecord), replace(execution, sample=True)
    execution.prepare([name])
    results = execution.run_tracks(name, record)
    if results.interrupted:
        raise execution.interrupted()
    folder = write_tracks(results, execution.folder(name))
    execution.forget(name)
    _show(results, folder, json)
    if results.faults:
        raise typer.Exit(failure.NOT_CONVERGED)


def _show(results: "TrackResults", folder: Path, json: bool) -> None:
    from needlefit.reporting.tables import records
    from needlefit.reporting.tracks.layouts import (
        coverage_layout,
        depths_layout,
        parameters_layout,
        scores_layout,
    )
    from needlefit.reporting.tracks.said import cautions, in_short
    from needlefit.validation.tracks.summary import paired_runs

    if json:
        screen.show_json(records(paired_runs(results)))
        return
    screen.say(f"{results.name}: {results.title}")
    kind = "SYNTHETIC" if results.origin == "synthetic" else "measured"
    for sentence in (f"{kind} data: {results.dataset_title}", *cautions(results)):
        screen.say(f"  {sentence}")
    for layout in (parameters_layout, scores_layout, depths_layout, coverage_layout):
        screen.show_display(layout(results))
    for sentence in in_short(results):
        screen.say(sentence)
    screen.say(f"written: {folder}/")
