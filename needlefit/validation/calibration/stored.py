"""A calibration as one file, from which its tables, figure and report are made again."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from needlefit.project.plain import plain
from needlefit.project.reading import stored_values
from needlefit.project.records.stored import CalibrationTable
from needlefit.project.run_file import read_timing, require_form
from needlefit.validation.calibration.run import Calibration
from needlefit.validation.packing import NAME, pack, packed, unpacked

KIND = "calibration"

_PLAIN = ("name", "title", "origin", "dataset_title", "control", "sampled", "interrupted", "run")
_TUPLES = ("insertions", "depths")
_FRAMES = ("replicates", "coverage", "ecdfs")


def store_calibration(found: Calibration, folder: Path) -> Path:
    """Write all of a calibration but its time to `folder`; equal ones give equal bytes."""
    table = {key: plain(getattr(found, key)) for key in _PLAIN}
    table |= {key: list(getattr(found, key)) for key in _TUPLES}
    frames = {key: packed(getattr(found, key)) for key in _FRAMES}
    return pack({"kind": KIND, **table, "frames": frames}, folder)


def restored_calibration(table: Mapping[str, Any], folder: Path) -> Calibration:
    """Return the calibration that a run stored as `table` in `folder`; DataError if it is damaged."""
    require_form(table, CalibrationTable, str(folder / NAME))
    seconds = read_timing(folder).get("seconds", 0.0)
    about: dict[str, Any] = {key: table[key] for key in _PLAIN}
    about |= {key: tuple(table[key]) for key in _TUPLES}
    with stored_values(folder / NAME):
        about |= {key: unpacked(table["frames"][key]) for key in _FRAMES}
        return Calibration(seconds=seconds, **about)
