"""What every kind of inquiry has to tell."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from needlefit.reporting.display import Display
from needlefit.reporting.document import Block
from needlefit.validation.analyses.runner import AnalysisResult

Figures = Mapping[str, Path]


@dataclass(frozen=True)
class Page:
    """How the answers of one kind are told.

    Attributes
    ----------
    said : callable
        Answer -> the answer in sentences, first things first.
    layouts : callable
        Answer -> its tables.
    draw : callable
        Answer and folder -> figures as PDF by name; beside each lies what it draws, as CSV of the same name.
    story : callable
        Answer and figures -> the body of the report, from what is behind the answer to its last table.
    """

    said: Callable[[AnalysisResult], list[str]]
    layouts: Callable[[AnalysisResult], list[Display]]
    draw: Callable[[AnalysisResult, Path], dict[str, Path]]
    story: Callable[[AnalysisResult, Figures], list[Block]]
