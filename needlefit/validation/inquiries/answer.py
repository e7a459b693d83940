"""The answer of an inquiry: tidy frames, and what a reader needs to know about where they come from."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import pandas as pd

from needlefit.project.records.inquiry import InquiryRecord


@dataclass(frozen=True)
class Answer:
    """What one inquiry found.

    Attributes
    ----------
    name : str
        Of the study's file.
    record : InquiryRecord
        What was asked; its `kind` says which verb asked and which page tells it.
    origin : "measured" or "synthetic"
        Synthetic as soon as anything in it is.
    dataset_title : str
        The data, in words.
    frames : mapping of DataFrame
        One row a fact, the unit in every column's name.
    run : dict
        All that decides the answer (versions, data, configuration, rules); no time and no path.
    timing : dict
        Seconds, jobs, paths.
    interrupted : bool
        Whether some of the work was left undone.
    faults : tuple of str
        Why something in it is not to be trusted.
    """

    name: str
    record: InquiryRecord
    origin: Literal["measured", "synthetic"]
    dataset_title: str
    frames: Mapping[str, pd.DataFrame]
    run: dict[str, Any]
    timing: dict[str, Any]
    interrupted: bool = False
    faults: tuple[str, ...] = ()

    @property
    def kind(self) -> str:
        """Which verb asked."""
        return str(self.record.kind)

    @property
    def title(self) -> str:
        """What stands over the report."""
        return self.record.title or self.name

    @property
    def synthetic(self) -> bool:
        """Whether anything in it is synthetic."""
        return self.origin == "synthetic"
