"""Write reference results: the numbers of a run, rounded so that only a changed result changes the files.

Lengths are rounded to 0.00001 mm, everything else to five significant digits: what pages print of it, to
0.01 mm or three digits, is then as if it were rounded once. Machines agree to 0.001 mm.
"""

from pathlib import Path

import pandas as pd

from needlefit.project.folders import replace_folder
from needlefit.reporting.table_files import to_tidy, write_csv, write_json
from needlefit.studies.fit_frames import FIT_KINDS
from needlefit.studies.report import list_run_files
from needlefit.studies.run import Run

LENGTH_DECIMALS = 5  #: decimals of a length in mm
SIGNIFICANT_DIGITS = 5  #: significant digits of all other numbers
MAX_ROWS = 500  #: longest table that is kept: longer ones are intermediate results that nobody reviews


def write_reference(run: Run, folder: Path) -> Path:
    """Write the tables of a run, rounded, and its `run.json` to `folder`; return it.

    Raises ConfigError if `folder` holds anything that needlefit did not write, or that was changed since.
    """
    with replace_folder(folder) as new:
        tables = {name: file for name, file in list_run_files(run).items() if not isinstance(file, str)}
        for name in REVIEWED_TABLES.get(run.kind, tables):
            frame = to_tidy(tables.get(name, pd.DataFrame()))
            if 0 < len(frame) <= MAX_ROWS:
                write_csv(round_frame(frame).assign(origin=run.origin), new / f"{name}.csv")
        table = dict(run.run_json)
        for name in ("source_revision", "validity"):  # they differ from machine to machine
            table.pop(name, None)
        write_json(new / "run.json", table)
    return folder


def round_frame(frame: pd.DataFrame) -> pd.DataFrame:
    """Return a frame with lengths rounded to 0.00001 mm and other numbers to five significant digits."""
    return frame.assign(**{str(name): _round_column(frame[name], str(name)) for name in frame})


REVIEWED_TABLES = {
    **dict.fromkeys(FIT_KINDS, ("checks", "validation", "tuning", "parameters", "errors", "predictive")),
}
"""Tables that are kept, by kind; of other kinds all are."""


def _round_column(column: pd.Series, name: str) -> pd.Series:
    if not pd.api.types.is_float_dtype(column):
        return column
    if name.endswith("_mm"):
        return column.round(LENGTH_DECIMALS) + 0.0  # no −0
    return column.map(lambda value: float(f"{value:.{SIGNIFICANT_DIGITS}g}"))
