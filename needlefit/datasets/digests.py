"""Digests of insertions: of all values in the files of a dataset that decide a fit to one of them.

They are of the values as they were read. What is computed from these differs in its last digit between
machines, on which a result is to be known again.
"""

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.columns import HOLE_COLUMN, NEEDLE_COLUMN, SETUP_COLUMN, InsertionRow
from needlefit.datasets.points import Points
from needlefit.geometry.smoothing_spline import SplineSections
from needlefit.project.input_files import digest_values
from needlefit.schemas.dataset import DatasetRecord
from needlefit.schemas.deciding import select_deciding

#: keys of a `dataset.toml` of which what was read for an insertion counts
_READ = ("root", "needle", "needles", "media", "insertions", "centerlines", "tip_tracks", "sections")
#: decimals (of mm) to which points and poses are rounded that were converted to world coordinates
DECIMALS = 6


def digest_insertion(
    row: InsertionRow,
    points: Points,
    sections: SplineSections | None,
    record: DatasetRecord,
    surfaces: Sequence[str],
) -> str:
    """Return the digest of an insertion, of whose surfaces these are the files' digests."""
    medium, patient = record.media[row.medium], row.patient
    values = {
        "dataset": select_deciding(record, _READ),
        "medium": select_deciding(medium, ("file",)),
        "surfaces": surfaces,
        "needle": select_deciding(record.all_needles[row.needle]),
        "row": _list_stated(replace(row, line=0, patient=None)),
        "scan": patient and [_round(patient.origin), _round(patient.rotation)],
        "points": _round(points.values),
        "sd": points.sd,
        "sections": sections and vars(sections),
    }
    return digest_values(values)


def _list_stated(row: InsertionRow) -> dict[str, Any]:
    """Return the fields of a row that differ from those of empty cells."""
    pairs = ((field, getattr(row, field.name)) for field in fields(row))
    return {
        field.name: value for field, value in pairs if isinstance(value, np.ndarray) or value != field.default
    }


def _round(values: Floats) -> Floats:
    return values.round(DECIMALS) + 0.0  # no -0


def digest_track(medium: str, readings: Mapping[str, Any], record: DatasetRecord) -> str:
    """Return the digest of a run, by the columns of its readings and the medium that it went into."""
    names = SETUP_COLUMN, HOLE_COLUMN
    values = {
        "dataset": select_deciding(record, _READ),
        "medium": (medium, select_deciding(record.media[medium])),
        "needle": select_deciding(record.all_needles[str(readings[NEEDLE_COLUMN][0])]),
        "readings": {name: column for name, column in readings.items() if name not in names},
    }
    values |= {name: text for name in names if (text := str(readings[name][0]))}
    if record.tip_tracks is not None and record.tip_tracks.depth_zero != "first_reading":
        values["depth_zero"] = record.tip_tracks.depth_zero
    return digest_values(values)
