"""A study of tip tracks as one file, from which its tables, figure and report are made again.

Draws of its posteriors stay in their own netCDF files beside it.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from needlefit.inference.sampling.posterior import load
from needlefit.project.plain import plain
from needlefit.project.reading import stored_values
from needlefit.project.records.stored import TracksTable
from needlefit.project.records.track_study import TrackStudyRecord
from needlefit.project.run_file import read_timing, require_form
from needlefit.validation.packing import NAME, pack, packed, unpacked
from needlefit.validation.tracks.results import TrackResults

KIND = "tracks"

_PLAIN = ("name", "origin", "dataset_title", "interrupted", "run")
_TUPLES = ("notes", "remarks")
_FRAMES = ("readings", "runs", "parameters")


def posterior_file(fit: str) -> str:
    """Return the file that holds the posterior of one fit."""
    return f"posterior-{fit}.nc"


def store_tracks(results: TrackResults, folder: Path) -> Path:
    """Write all of `results` but posteriors and times to `folder`; equal results give equal bytes."""
    table = {key: plain(getattr(results, key)) for key in _PLAIN}
    table |= {key: list(getattr(results, key)) for key in _TUPLES}
    table["record"] = results.record.model_dump(mode="json", by_alias=True)
    table["posteriors"] = list(results.posteriors)
    frames = {key: packed(getattr(results, key)) for key in _FRAMES}
    return pack({"kind": KIND, **table, "frames": frames}, folder)


def restored_tracks(table: Mapping[str, Any], folder: Path) -> TrackResults:
    """Return the results that a run stored as `table` in `folder`; DataError if it is damaged."""
    require_form(table, TracksTable, str(folder / NAME))
    about: dict[str, Any] = {key: table[key] for key in _PLAIN}
    about |= {key: tuple(table[key]) for key in _TUPLES}
    with stored_values(folder / NAME):
        about |= {key: unpacked(table["frames"][key]) for key in _FRAMES}
        return TrackResults(
            record=TrackStudyRecord.model_validate(table["record"]),
            timing=read_timing(folder),
            posteriors={fit: load(folder / posterior_file(fit)) for fit in table["posteriors"]},
            **about,
        )
