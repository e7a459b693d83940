"""Frames, columns and keys of stored results that have another name today.

Never change a line here: add one.
"""

from collections.abc import Mapping
from types import MappingProxyType

Names = Mapping[str, str]

RENAMED_FRAMES: Mapping[str, Names] = MappingProxyType(
    {
        "adaptation": {"reached": "insertions_needed", "gained": "gains"},
        "comparison": {"contest": "group_differences", "against": "comparison"},
        "next_insertion": {"told": "gains"},
        "plan": {"beyond": "exceedances"},
        "seeds": {"contests": "comparisons"},
    }
)
"""By kind of study."""

_COUNTS = {"least": "count_low", "most": "count_high"}

RENAMED_FILES: Names = MappingProxyType({"foretold": "predicted", "rivals": "baselines"})
"""Tables that lie beside figures."""

RENAMED_COLUMNS: Mapping[str, Names] = MappingProxyType(
    {
        "adaptation": {"way": "method", "worst_pareto_k": "pareto_k", "sets": "groups", "approach": "method"},
        "alphas": {"sd_before": "sd_now"},
        "candidates": {"worth": "ess", "tip_mm": "deflection_mm"},
        "cells": {"of": "aspect", "table": "grouping", "as_decided": "baseline_value", "seeds": "replicates"},
        "comparison": {
            "fewest_independent_draws": "ess",
            "min_ess": "ess",
            "worst_pareto_k": "pareto_k",
            "candidate": "method",
        },
        "comparisons": {
            "rival": "method",
            "explanation": "note",
            "twins": "replicates",
            "twins_better": "replicates_better",
            "fitted_mm": "value",
            "method_mm": "baseline_value",
            "rival_mm": "baseline_value",
            "floor_mm": "floor",
            "difference_mm": "difference",
            "low_mm": "low",
            "high_mm": "high",
            "pairs_better": "share",
        },
        "coverage": {
            "rival": "method",
            "what": "quantity",
            "held": "covered",
            **_COUNTS,
            "phantoms": "specimens",
        },
        "curves": {"way": "method", "approach": "method"},
        "depths": {"rival": "method", "from_mm": "low_mm", "to_mm": "high_mm"},
        "differences": {"candidate": "method"},
        "directions": {"contraction": "sd_ratio", "words": "note"},
        "draws": {"from": "draw_source"},
        "ecdfs": {"place": "rank", **_COUNTS},
        "errors": {"rival": "method", "way": "method", "of": "aspect", "approach": "method"},
        "exceedances": {"what": "object", "plan": "method"},
        "failures": {"reason": "note"},
        "fits": {"way": "method", "approach": "method", "candidate": "method"},
        "gains": {
            "rival": "baseline",
            "measure": "metric",
            "gain_low_mm": "low",
            "gain_high_mm": "high",
            "gain_mm": "difference",
        },
        "group_differences": {"candidate": "method"},
        "identification": {
            "says": "profile_verdict",
            "contraction": "sd_ratio",
            "tip_moves_mm": "tip_range_mm",
            "interval_low": "low",
            "interval_high": "high",
        },
        "insertions_needed": {
            "way": "method",
            "measure": "metric",
            "n_low": "low",
            "n_high": "high",
            "target_mm": "value",
            "approach": "method",
        },
        "layers": {"from_mm": "low_mm", "to_mm": "high_mm"},
        "misses": {"plan": "method"},
        "needles": {"plan": "method"},
        "paired": {
            "rival": "method",
            "measure": "metric",
            "mean_mm": "value",
            "difference_mm": "difference",
            "difference_low_mm": "low",
            "difference_high_mm": "high",
        },
        "parameter_cells": {"seeds": "replicates"},
        "parameter_changes": {"of": "aspect", "as_decided": "baseline_value"},
        "parameters": {
            "rival": "method",
            "contraction": "sd_ratio",
            "of": "aspect",
            "spread_low": "low",
            "spread_high": "high",
            "true": "truth",
        },
        "pattern": {"threshold_mm": "limit_mm"},
        "plans": {"tried": "draws", "sought_rms_mm": "search_rms_mm", "plan": "method"},
        "population": {"what": "quantity"},
        "posterior": {"independent": "ess", "fault": "note"},
        "predictive": {"from": "draw_source", "tip_level": "tip_pit", "shape_level": "shape_pit"},
        "readings": {"rival": "method"},
        "recovered": {"what": "quantity"},
        "regions": {"alpha_low": "low", "alpha_high": "high"},
        "remarks": {"remark": "note"},
        "replicates": {"by": "draw_source", "independent": "ess", "trusted": "certified"},
        "runs": {"rival": "method", "track_level": "track_pit"},
        "scores": {"independent_draws": "ess", "candidate": "method"},
        "shapes": {"rival": "method"},
        "specimens": {"trusted": "certified"},
        "starts": {"as_good": "within_tolerance"},
        "studies": {"of": "aspect", "threshold_mm": "limit_mm"},
        "summary": {
            "worst_pareto_k": "pareto_k",
            "gap": "difference",
            "gap_se": "difference_se",
            "curve": "baseline_value",
            "folds_sampled": "sampled",
        },
        "tuning": {"by": "grouping", "reread": "alternate_count"},
        "validation": {"reread": "alternate_count", "rival": "method"},
        "verification": {"remark": "note"},
    }
)
"""By frame, as it is called today."""

RENAMED_VALUES: Mapping[tuple[str, str], Names] = MappingProxyType(
    {
        ("population", "parameter"): {"best_told": "best_determined"},
        ("densities", "parameter"): {"best_told": "best_determined"},
    }
)
"""By frame and column, as they are called today."""

RENAMED_RUN_KEYS: Names = MappingProxyType(
    {
        "from": "draw_source",
        "mend": "fix",
        "pieces": "tasks",
        "rival": "method",
    }
)
"""Of `run.json`, at any depth; what it repeats of a study or recipe follows their own keys."""
