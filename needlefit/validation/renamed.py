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
        "adaptation": {"way": "approach"},
        "candidates": {"worth": "ess"},
        "cells": {"of": "aspect"},
        "comparison": {"fewest_independent_draws": "min_ess"},
        "comparisons": {"rival": "method", "rival_mm": "method_mm"},
        "coverage": {"rival": "method", "what": "quantity", "held": "covered", **_COUNTS},
        "curves": {"way": "approach"},
        "depths": {"rival": "method"},
        "directions": {"contraction": "sd_ratio"},
        "draws": {"from": "draw_source"},
        "ecdfs": {"place": "rank", **_COUNTS},
        "errors": {"rival": "method", "way": "approach", "of": "aspect"},
        "exceedances": {"what": "object"},
        "fits": {"way": "approach"},
        "gains": {"rival": "baseline"},
        "identification": {
            "says": "profile_verdict",
            "contraction": "sd_ratio",
            "contraction_sampled": "sd_ratio_sampled",
            "tip_moves_mm": "tip_range_mm",
        },
        "insertions_needed": {"way": "approach"},
        "paired": {"rival": "method"},
        "parameter_changes": {"of": "aspect"},
        "parameters": {"rival": "method", "contraction": "sd_ratio", "of": "aspect"},
        "plans": {"tried": "draws", "sought_rms_mm": "search_rms_mm"},
        "population": {"what": "quantity"},
        "posterior": {"independent": "ess"},
        "predictive": {"from": "draw_source", "tip_level": "tip_pit", "shape_level": "shape_pit"},
        "ranks": {
            "least_less_uniform": "count_low_less_uniform",
            "most_less_uniform": "count_high_less_uniform",
        },
        "readings": {"rival": "method"},
        "recovered": {"what": "quantity"},
        "replicates": {"by": "draw_source", "independent": "ess"},
        "runs": {"rival": "method", "track_level": "track_pit"},
        "scores": {"independent_draws": "ess"},
        "shapes": {"rival": "method"},
        "starts": {"as_good": "within_tolerance"},
        "studies": {"of": "aspect"},
        "tuning": {"by": "grouping", "reread": "alternate_count"},
        "validation": {"reread": "alternate_count", "rival": "method"},
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
