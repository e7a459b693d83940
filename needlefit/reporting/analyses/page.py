"""The interface that the report of every kind of analysis implements."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from needlefit.reporting.document import Block
from needlefit.reporting.table_layout import TableLayout
from needlefit.validation.analyses.runner import AnalysisResult

FigurePaths = Mapping[str, Path]


@dataclass(frozen=True)
class AnalysisPage:
    """The functions that report the results of one kind of analysis.

    Attributes
    ----------
    summarize : callable
        Result -> its sentences, the most important first.
    lay_out : callable
        Result -> its tables.
    draw : callable
        Result and folder -> figures as PDF by name; beside each lies what it draws, as CSV of the same name.
    compose : callable
        Result and figures -> the body of the report, down to its last table.
    """

    summarize: Callable[[AnalysisResult], list[str]]
    lay_out: Callable[[AnalysisResult], list[TableLayout]]
    draw: Callable[[AnalysisResult, Path], dict[str, Path]]
    compose: Callable[[AnalysisResult, FigurePaths], list[Block]]
