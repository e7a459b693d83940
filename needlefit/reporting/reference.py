"""Write reference results: the numbers of a run, rounded so that only a changed result changes the files.

Lengths are rounded to 0.001 mm, in which machines agree; everything else to three significant digits. Of
`run.json` what the answer was computed with and what it could not tell is kept; how many evaluations that
took is not, for it differs from machine to machine.
"""

import math
from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from needlefit.project.atomic_write import replace_folder
from needlefit.reporting.parameter_table import tabulate_parameters
from needlefit.reporting.table_files import write_csv, write_json
from needlefit.reporting.tables import tabulate_tuning, tabulate_validation
from needlefit.validation.analyses.runner import AnalysisResult
from needlefit.validation.results import Results
from needlefit.validation.tracks.results import TrackResults, compare_methods_by_run, tabulate_coverage
from needlefit.validation.validity import VALIDITY_KEY

LENGTH_DECIMALS = 3
"""Decimals of a length in mm."""

SIGNIFICANT_DIGITS = 3
"""Significant digits of all other numbers."""

MAX_ROWS = 500
"""Longest table that is kept: longer ones are intermediate results that nobody reviews."""

_COUNT_KEYS = (
    "searches",
    "evaluations",
    "failed_solves",
    "failed_solves_of_sampler",
    "recorded_failures",
    VALIDITY_KEY,
)


def write_reference(one: Results | AnalysisResult | TrackResults, folder: Path) -> Path:
    """Write the tables of a run, rounded, and its `run.json` to `folder`; return it.

    Raises
    ------
    ConfigError
        If `folder` holds anything that needlefit did not write, or that was changed since.
    """
    with replace_folder(folder) as new:
        for name, frame in _collect_frames(one).items():
            if 0 < len(frame) <= MAX_ROWS:
                write_csv(round_frame(frame).assign(origin=one.origin), new / f"{name}.csv")
        write_json(new / "run.json", {key: one.run[key] for key in one.run if key not in _COUNT_KEYS})
    return folder


def round_frame(frame: pd.DataFrame) -> pd.DataFrame:
    """Return a frame with lengths rounded to 0.001 mm and other numbers to three significant digits."""
    return frame.assign(**{str(name): _round_column(frame[name], str(name)) for name in frame})


def _collect_frames(one: Results | AnalysisResult | TrackResults) -> Mapping[str, pd.DataFrame]:
    if isinstance(one, AnalysisResult):
        return one.frames
    if isinstance(one, TrackResults):
        return {
            "paired": compare_methods_by_run(one),
            "coverage": tabulate_coverage(one),
            "parameters": one.parameters,
        }
    tables = {"validation": tabulate_validation(one), "tuning": tabulate_tuning(one)}
    return tables | {
        "parameters": tabulate_parameters(one),
        "errors": one.errors,
        "predictive": one.predictive,
    }


def _round_column(column: pd.Series, name: str) -> pd.Series:
    if not pd.api.types.is_float_dtype(column):
        return column
    if name.endswith("_mm"):
        return column.round(LENGTH_DECIMALS) + 0.0  # no −0
    return column.map(_round_significant)


def _round_significant(value: float) -> float:
    if not math.isfinite(value) or value == 0:
        return value
    return round(value, SIGNIFICANT_DIGITS - 1 - math.floor(math.log10(abs(value))))
