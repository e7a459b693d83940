"""The tables of a study or a fit: one fact per row, the unit in every column's name.

errors
    One row per fold, role ("tune", "validate"), insertion, method and boundaries ("measured", as in the
    paper, or "planned"), with a column per metric (`needlefit.metrics`) and its noise floor. `estimate` is
    "median" for the predictive median of insertions held out, else "point". `layers` is by the study's rule.
    `comparison` is "world", "shifted" across where the direction of the entry alone is known, or "aligned"
    for shapes known only up to a rigid motion; `edp_flagged` marks a deflection below the noise floor.
shapes
    The curves that `errors` compares, j = 0 the entry (or the first scored point), as compared.
starts
    Every start of every search, then one column per parameter. `objective` is what was `minimized`: the
    negative log "posterior", or mm of the "metric"; `excess` is how far it is above the best of its search,
    in units of the tolerance (0.1; 1 % or 0.002 mm); `joined` is the start that it met and went on with.

Parameters
    Values per fold and method; `sd` is of ln for moduli and lengths, of the value for alpha; `low`, `high` is
    the range among starts within tolerance of the best; `interval_low`, `interval_high` is the 95 % interval
    that is printed, `draw_source` what it is from, `median` that of the same draws. `determined` is "yes",
    "only together" (with the others held it is), or "no".
error_fit
    Per fold the objective of the error-minimising fit: at the reported point, at the least one, and the
    tolerance within which it is not significantly larger, with its two estimates.
directions
    Combinations of parameters in words, how many each names, and the standard deviation to which it is known.
identification
    Of a fit: per fold and free parameter the information (`sd`), the profile likelihood (the 95 % interval,
    how its ends came about, how far the deviance rises at most), and posterior SD / prior SD.
profiles
    Deviances of the profiles and their derivatives by ln (by alpha itself), then one column per parameter.
predictive
    The predictive distribution of every insertion held out, and how the measurement fell in it: `tip_pit` is
    the probability predicted of a tip up to the measured one, `shape_pit` of a shape nearer, at its worst
    point, than the measured one.
bands
    Where each insertion held out was predicted to be measured, point by point, at its measured x.
curvature
    The reading of every sensor of these insertions along y, and in space along z, as measured and predicted.
draws
    Draws of each fold's parameters, with Pareto's k where by importance; `specimen` is "(tuned)" (of several
    that differ, their mean), one of several that differ, or "(new)"; then one column per parameter.
population
    How much parameters differ between the specimens that were fitted, by the logarithm: SD, and correlation
    of mu with the bevel parameter. Empty where one set of parameters is for all.
needles
    Every insertion held out, or, of a single fold, any, point by point in its scan; the single point of the
    curve "toward" is a direction.
"""

from collections.abc import Mapping
from types import MappingProxyType

import pandas as pd

from needlefit.inference.baselines import list_baselines

FIT_KINDS = ("cross_validation", "fit")  #: kinds of study whose runs have the tables of this module

#: in place of a specimen's name: those that were tuned on, together, and one that is not in the dataset
TUNED_SPECIMENS, NEW_SPECIMEN = "(tuned)", "(new)"

DRAW_COLUMNS = ("fold", "specimen", "draw_source", "pareto_k", "ess", "certified")
#: the method of predictions: the median of the predictive distribution, point by point
MEDIAN_METHOD = "predictive_median"
#: the methods that simulate a needle: both fits, the paper's parameters, and these with b fitted again
MODEL_METHODS = ("fitted", "fitted_metric", "hand_tuned", "hand_tuned_b")
SCORE_KEYS = ("fold", "role", "insertion", "method", "boundaries")
_PREDICTIVE_COLUMNS = (
    *("fold", "insertion", "hole", "specimen", "medium", "layers", "depth_mm", "specimen_treatment"),
    *("between_sd_ln_mu", "between_sd_ln_b", "between_correlation", "other_specimens"),
    *("tip_95_width_after_one_mm", "draw_source", "certified", "draws", "failed_solves", "tip_measured_mm"),
    *("tip_median_mm", "tip_50_low_mm", "tip_50_high_mm", "tip_95_low_mm", "tip_95_high_mm", "tip_pit"),
    *("tip_in_50", "tip_in_95", "tip_crps_mm", "tip_interval_score_mm", "shape_pit", "shape_in_50"),
    *("shape_in_95", "shape_crps_mm"),
)

COLUMNS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "errors": (
            *("fold", "role", "insertion", "medium", "hole", "specimen", "layers", "depth_mm"),
            *("method", "estimate", "boundaries", "comparison"),
            *("deflection_mm", "predicted_deflection_mm", "edp_flagged", "converged"),
        ),
        "shapes": (
            *(*SCORE_KEYS, "j", "measured_x_mm", "measured_y_mm", "measured_z_mm"),
            *("simulated_x_mm", "simulated_y_mm", "simulated_z_mm"),
        ),
        "starts": (
            *("fold", "fit", "start", "minimized", "objective", "excess", "within_tolerance"),
            *("evaluations", "gradients", "failed_solves", "stopped", "joined"),
        ),
        "parameters": (
            *("fold", "method", "parameter", "value", "status", "bound_low", "bound_high"),
            *("sd", "low", "high", "interval_low", "interval_high", "draw_source"),
            "median",
            *("determined", "condition", "note"),
        ),
        "error_fit": (
            *("fold", "objective_mm", "least_objective_mm", "tolerance_mm"),
            *("tolerance_by_noise_mm", "tolerance_by_insertions_mm", "evaluations"),
        ),
        "directions": ("fold", "parameters", "sd", "sd_ratio", "note"),
        "identification": (
            *("fold", "parameter", "determined", "note", "value", "prior_sd"),
            *("sd", "fisher_sd", "sd_ratio", "low", "high", "end_low", "end_high"),
            *("interval_low", "interval_high", "draw_source", "bound_low", "bound_high"),
            "rise",
        ),
        "profiles": ("fold", "parameter", "value", "deviance", "slope", "threshold"),
        "predictive": _PREDICTIVE_COLUMNS,
        "bands": (
            *("fold", "insertion", "x_mm", "measured_mm", "median_mm"),
            *("low_50_mm", "high_50_mm", "low_95_mm", "high_95_mm"),
        ),
        "curvature": (
            *("fold", "insertion", "s_mm", "direction", "kappa_1_per_mm"),
            *("kappa_predicted_1_per_mm", "kappa_sd_1_per_mm", "kappa_in_95"),
        ),
        "draws": DRAW_COLUMNS,
        "population": ("fold", "parameter", "between_sd", "between_correlation", "other_specimens"),
        "needles": (
            *("fold", "role", "insertion", "diameter_mm", "band_source"),
            *("curve", "j", "x_mm", "y_mm", "z_mm"),
        ),
    }
)


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
