"""The result of a study or a fit: tidy tables, and their provenance."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal

import pandas as pd

from needlefit.inference.sampling.posterior import Posterior
from needlefit.schemas.study import FitRecord, StudyRecord
from needlefit.validation.held_out_predictions import BAND_COLUMNS, PREDICTIVE_COLUMNS
from needlefit.validation.identification import IDENTIFICATION_COLUMNS, PROFILE_COLUMNS
from needlefit.validation.needles_in_scan import NeedleInScan

METRICS = ("median_err_mm", "ipe_mean_mm", "ipe_std_mm", "ipe_max_mm", "te_mm", "edp_percent")
FLOOR_COLUMNS = ("floor_median_err_mm", "floor_ipe_mean_mm", "floor_ipe_max_mm", "floor_te_mm")
BASELINES = ("straight", "constant_curvature", "linear_curvature")
METHODS = ("fitted", "fitted_metric", "hand_tuned", "hand_tuned_b", *BASELINES)
DRAW_COLUMNS = ("fold", "draw_source", "pareto_k", "certified")
SCORE_KEYS = ("fold", "role", "insertion", "method", "boundaries")

COLUMNS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "design": (
            *("role", "medium", "layers", "insertions", "insertions_other", "depth_min_mm", "depth_max_mm"),
            *("deflection_min_mm", "deflection_max_mm"),
        ),
        "errors": (
            *("fold", "role", "insertion", "medium", "specimen", "layers", "layers_other", "depth_mm"),
            *("method", "boundaries", "comparison"),
            *METRICS,
            *("deflection_mm", "predicted_deflection_mm"),
            *FLOOR_COLUMNS,
            *("edp_flagged", "converged"),
        ),
        "shapes": (*SCORE_KEYS, "j", "measured_x_mm", "measured_y_mm", "simulated_x_mm", "simulated_y_mm"),
        "starts": (
            *("fold", "fit", "start", "minimized", "objective", "excess", "within_tolerance"),
            *("evaluations", "gradients", "failed_solves", "stopped", "joined"),
        ),
        "failures": ("fold", "fit", "start", "insertion", "reason"),
        "parameters": (
            *("fold", "method", "parameter", "value", "status", "bound_low", "bound_high"),
            *("sd", "spread_low", "spread_high", "determined", "note"),
        ),
        "directions": ("fold", "sd", "words"),
        "identification": IDENTIFICATION_COLUMNS,
        "profiles": PROFILE_COLUMNS,
        "predictive": PREDICTIVE_COLUMNS,
        "bands": BAND_COLUMNS,
        "draws": DRAW_COLUMNS,
    }
)


@dataclass(frozen=True)
class Results:
    """The result of one study or fit: tables with one fact per row and the unit in every column's name.

    Attributes
    ----------
    name, title, question : str
        Of the study; `name` is the name of its file.
    record : StudyRecord or FitRecord
        What was asked for.
    origin : str
        "measured" or "synthetic", of the dataset.
    dataset_title : str
        The dataset, in words.
    design : DataFrame
        Insertions, depths and measured deflections of the tip (toward the bevel) per role ("tune",
        "validate"), medium and layers; `insertions_other` is how many of the same insertions count so by the
        other reading of needles that end at a boundary.
    errors : DataFrame
        One row per fold, role, insertion, method and boundaries ("measured", as the paper does;
        "planned"). `layers` is by the study's reading, `layers_other` by the other. `comparison` is "world",
        or "aligned" for shapes known only up to a rigid motion;
        `edp_flagged` marks a deflection under the noise floor.
    shapes : DataFrame
        The curves that `errors` compares, j = 0 the entry (or the first scored point), as compared.
    starts : DataFrame
        Every start of every search, then one column per parameter. `objective` is what was `minimized`: the
        negative log "posterior", or mm of the "metric"; `excess` is how far it is above the best of its
        search, in units of what still counts as practically as good (0.1; 1 % or 0.002 mm),
        `within_tolerance` whether that is at most 1; `gradients` are the evaluations with derivatives among
        all; `joined` is the start that it met on its approach and went on with, empty if none.
    failures : DataFrame
        The first evaluations that failed, of every start and of every ensemble of the sampler (`fit` is
        then "posterior"): the insertion without a solution, why it has none, then one column per
        parameter. Simulated again with these values it fails again; `starts` counts all.
    parameters : DataFrame
        Values per fold and method; `sd` is of ln for moduli and lengths, of the value for alpha;
        `spread_low`, `spread_high` is the range among starts practically as good as the best.
    directions : DataFrame
        Combinations of parameters in words, with the standard deviation to which each is known.
    identification : DataFrame
        Of a fit: per fold and parameter what information (`sd`), profile likelihood (the 95 % interval, how
        its ends `end_low`, `end_high` came about, how far the deviance rises at most) and the posterior's
        contraction against the prior say, and whether they agree; alphas that were fixed are freed for it.
    predictive : DataFrame
        The distribution predicted of every insertion held out (`validation/held_out_predictions.py`), and how
        what was measured fell in it.
    bands : DataFrame
        Where each insertion held out was predicted to be measured, point by point.
    draws : DataFrame
        Draws of each fold's parameters: from its sampled posterior, or by importance about the modes of its
        fit, then with Pareto's k of the weights; then one column per parameter.
    profiles : DataFrame
        Deviances of the profiles and their derivatives by ln (by alpha itself), then one column per
        parameter: where all others went.
    run : dict
        Versions, seeds, digests, configuration, model rules: no time, no path.
    timing : dict
        Times, durations and paths.
    interrupted : bool
        Stopped by the user: the best found so far.
    posteriors : mapping
        The sampled posterior by fold, where one was asked for.
    needles : mapping
        Every insertion held out, or, of a single fold, any, by its id: measured and fitted, in its scan.

    Raises
    ------
    ValueError
        If a frame lacks one of its columns.
    """

    name: str
    title: str
    question: str
    record: StudyRecord | FitRecord
    origin: Literal["measured", "synthetic"]
    dataset_title: str
    design: pd.DataFrame
    errors: pd.DataFrame
    shapes: pd.DataFrame
    starts: pd.DataFrame
    failures: pd.DataFrame
    parameters: pd.DataFrame
    directions: pd.DataFrame
    run: dict[str, Any]
    timing: dict[str, Any]
    interrupted: bool
    posteriors: Mapping[str, Posterior] = field(default_factory=dict)
    needles: Mapping[str, NeedleInScan] = field(default_factory=dict)
    identification: pd.DataFrame = field(
        default_factory=lambda: pd.DataFrame(columns=list(IDENTIFICATION_COLUMNS))
    )
    profiles: pd.DataFrame = field(default_factory=lambda: pd.DataFrame(columns=list(PROFILE_COLUMNS)))
    bands: pd.DataFrame = field(default_factory=lambda: pd.DataFrame(columns=list(BAND_COLUMNS)))
    draws: pd.DataFrame = field(default_factory=lambda: pd.DataFrame(columns=list(DRAW_COLUMNS)))
    predictive: pd.DataFrame = field(default_factory=lambda: pd.DataFrame(columns=list(PREDICTIVE_COLUMNS)))

    def __post_init__(self) -> None:
        for frame, columns in COLUMNS.items():
            missing = [name for name in columns if name not in getattr(self, frame).columns]
            if missing:
                raise ValueError(f"Results.{frame} lacks {', '.join(missing)}")
