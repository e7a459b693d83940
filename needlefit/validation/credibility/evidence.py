"""Evidence: what another command left in a folder, and why it counts for a run or does not."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import pandas as pd

Kind = Literal["verification", "calibration", "identification", "sensitivity"]

TABLES: Mapping[Kind, Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        "verification": {
            "verification.csv": (
                *("group", "check", "quantity", "measured", "bound_low", "bound_high", "unit", "verdict"),
            )
        },
        "calibration": {"coverage.csv": ("quantity", "level", "replicates", "covered", "least", "most")},
        "identification": {"identify.csv": ("stage", "parameter", "status", "determined", "says")},
        "sensitivity": {
            "cells.csv": (
                *("of", "variation", "tuned", "table", "study", "medium", "layers", "metric"),
                *("change", "change_in_floors"),
            ),
            "studies.csv": ("of", "variation", "tuned", "study", "threshold_mm", "conclusion_changes"),
        },
    }
)
"""The tables that evidence of each kind is read from, and the columns that are read."""

FIGURES: Mapping[Kind, str] = MappingProxyType(
    {"verification": "convergence.pdf", "calibration": "ranks.pdf"}
)
"""The figure that shows it, where there is one."""


@dataclass(frozen=True)
class Evidence:
    """What one command left, looked at for one run.

    Attributes
    ----------
    kind : str
        Which command: "verification", "calibration", "identification" or "sensitivity".
    folder : Path
    of : str
        The study or fit that it is looked at for; empty for what is about the program.
    run : mapping
        Its `run.json`.
    tables : mapping of DataFrame
        By file name.
    objections : tuple of str
        Why it is not of the same thing as the run, and so is not counted; empty if it is.
    digests : mapping of str
        sha256 of the files read, by name.
    """

    kind: Kind
    folder: Path
    of: str
    run: Mapping[str, Any]
    tables: Mapping[str, pd.DataFrame]
    objections: tuple[str, ...]
    digests: Mapping[str, str]

    @property
    def place(self) -> str:
        """The name of its folder."""
        return self.folder.name

    @property
    def counted(self) -> bool:
        """Whether it is of the same thing as the run."""
        return not self.objections

    @property
    def command(self) -> str:
        """What made it."""
        if self.kind == "verification":
            return "needlefit verify"
        if self.kind == "sensitivity":
            return f"needlefit validate {self.run['name']}"
        if self.kind == "identification":
            name = str(self.run["design"]["name"]).removeprefix("identify-")
            return f"needlefit identify {name}" + (" --fit" if "fit" in self.run else "")
        sample = " --sample" if self.run.get("sampled") else ""
        control = f" --control {self.run['control']}" if self.run.get("control") else ""
        return (
            f"needlefit calibrate {self.run['name']} --replicates {self.run['replicates']}{sample}{control}"
        )
