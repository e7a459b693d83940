"""What a report prints of insertions by how they were observed: a file of this folder for each observation.

Each has the name of its observation in `inference/likelihood/observations/`. What has no file is printed as
points along the needle are.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd

from needlefit.registry import Registry
from needlefit.reporting.figures import Drawing
from needlefit.reporting.table import TableLayout
from needlefit.studies.first_page import FirstPage
from needlefit.studies.run import Run


@dataclass(frozen=True)
class ObservationReport:
    """The parts of a report that differ between observations; callables take the run."""

    name: str  #: of the observation
    #: whether the insertions that are scored were observed so; points are what no other one holds for
    holds: Callable[[Run], bool]
    #: run, what its text prints -> its first page
    first_page: Callable[[Run, Mapping[str, Any]], FirstPage]
    #: run, role -> its own figures, that of the first page first
    figures: Callable[[Run, str], Mapping[str, Drawing]]
    #: run -> the tables before those of all observations
    tables: Callable[[Run], list[TableLayout]] = lambda run: []
    #: run -> further tables that are written as CSV, by name
    files: Callable[[Run], Mapping[str, pd.DataFrame]] = lambda run: {}
    #: run -> further values of the text
    values: Callable[[Run], Mapping[str, Any]] = lambda run: {}


OBSERVATION_REPORTS = Registry(ObservationReport, __name__, "report of an observation")


def find_observation_report(run: Run) -> ObservationReport:
    """Return what is printed of the insertions that a run scores."""
    others = (one for one in OBSERVATION_REPORTS.values() if one.name != "points")
    return next((one for one in others if one.holds(run)), OBSERVATION_REPORTS["points"])
