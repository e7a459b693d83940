"""Select rows of the tables of a fit or cross-validation; names that stand in their cells."""

from dataclasses import dataclass, fields
from typing import Self

import pandas as pd

from needlefit.inference.baselines import list_baselines
from needlefit.metrics import IPE
from needlefit.reporting.table_files import select_rows
from needlefit.studies.run import Run

FIT_KINDS = ("cross_validation", "fit")  #: kinds of study whose runs have these tables

#: in place of a specimen's name: those that were tuned on, together, and one that is not in the dataset
TUNED_SPECIMENS, NEW_SPECIMEN = "(tuned)", "(new)"

#: our prediction: the needle of the posterior mode, through the layers that it meets itself, or the median
PREDICTION_METHOD = "prediction"
#: the methods that simulate a needle: both fits, b fitted alone with the others as they are before any data,
#: and the paper's parameters
MODEL_METHODS = ("fitted", "fitted_metric", "b_alone", "hand_tuned")


@dataclass(frozen=True)
class FitFrames:
    """The tables of a fit or cross-validation, by their names in `Run.frames`."""

    errors: pd.DataFrame
    shapes: pd.DataFrame
    starts: pd.DataFrame
    parameters: pd.DataFrame
    error_fit: pd.DataFrame
    directions: pd.DataFrame
    identification: pd.DataFrame
    profiles: pd.DataFrame
    predictive: pd.DataFrame
    bands: pd.DataFrame
    curvature: pd.DataFrame
    readings: pd.DataFrame
    draws: pd.DataFrame
    population: pd.DataFrame
    needles: pd.DataFrame

    @classmethod
    def of(cls, run: Run) -> Self:
        return cls(**{field.name: run.frames[field.name] for field in fields(cls)})

    @property
    def role(self) -> str:
        """The role that is scored: "validate", or "tune" for a fit without held-out insertions."""
        return "validate" if (self.errors["role"] == "validate").any() else "tune"

    @property
    def method(self) -> str:
        """The method whose errors are judged: our prediction, of a run without any the fit."""
        return PREDICTION_METHOD if (self.errors["method"] == PREDICTION_METHOD).any() else "fitted"

    @property
    def curved(self) -> bool:
        """Whether curves are compared, not tips alone: without one IPE means nothing."""
        return IPE.name in self.errors and bool(self.errors[IPE.name].notna().any())

    @property
    def free_parameters(self) -> pd.DataFrame:
        """The rows of the parameters that the fit estimated, of all folds."""
        return select_rows(self.parameters, method="fitted", status="free")

    def select_errors(self, **place: object) -> pd.DataFrame:
        """Return errors with layers where they were measured, of the role that is scored unless stated."""
        return select_rows(self.errors, **{"role": self.role, "boundaries": "measured", **place})

    def select_curves(self, **place: object) -> pd.DataFrame:
        """Return points of whole needles, none of tips, as of `select_errors`."""
        shapes = select_rows(self.shapes, **{"role": self.role, "boundaries": "measured", **place})
        return shapes[shapes.groupby("insertion")["j"].transform("max") > 1]


def list_methods() -> tuple[str, ...]:
    """Return the names of all methods in the order of tables: models, then baselines."""
    fitted, *others = MODEL_METHODS
    return (fitted, PREDICTION_METHOD, *others, *(baseline.name for baseline in list_baselines()))
