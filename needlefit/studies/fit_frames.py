"""Select rows of the tables of a fit or cross-validation; names that stand in their cells."""

import pandas as pd

from needlefit.inference.baselines import list_baselines

FIT_KINDS = ("cross_validation", "fit")  #: kinds of study whose runs have these tables

#: in place of a specimen's name: those that were tuned on, together, and one that is not in the dataset
TUNED_SPECIMENS, NEW_SPECIMEN = "(tuned)", "(new)"

#: the method of predictions: the median of the predictive distribution, point by point
MEDIAN_METHOD = "predictive_median"
#: the methods that simulate a needle: both fits, the paper's parameters, and these with b fitted again
MODEL_METHODS = ("fitted", "fitted_metric", "hand_tuned", "hand_tuned_b")


def select_draws(
    draws: pd.DataFrame, fold: str | None = None, specimen: str = TUNED_SPECIMENS
) -> pd.DataFrame:
    """Return the draws of one fold, by default the first, in one specimen, by default those tuned on."""
    if draws.empty:
        return draws
    name = draws["fold"].iloc[0] if fold is None else fold
    found: pd.DataFrame = draws[(draws["fold"] == name) & (draws["specimen"] == specimen)]
    return found


def find_scored_role(errors: pd.DataFrame) -> str:
    """Return the role that is scored: "validate", or "tune" for a fit without held-out insertions."""
    return "validate" if (errors["role"] == "validate").any() else "tune"


def select_fitted(frame: pd.DataFrame, role: str = "validate", method: str = "fitted") -> pd.DataFrame:
    """Return the rows of a method on the insertions of a role, with layers where they were measured."""
    boundaries = frame["boundaries"] == "measured"
    return frame[(frame["role"] == role) & (frame["method"] == method) & boundaries]


def select_free(parameters: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of the parameters that the fit estimated, of all folds."""
    return parameters[(parameters["method"] == "fitted") & (parameters["status"] == "free")]


def list_methods() -> tuple[str, ...]:
    """Return the names of all methods in the order of tables: models, then baselines."""
    fitted, *others = MODEL_METHODS
    return (fitted, MEDIAN_METHOD, *others, *(baseline.name for baseline in list_baselines()))
