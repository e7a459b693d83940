"""Which sentences about a fit or cross-validation are printed, by what was found: one table.

A block of `reporting/text/cross_validation.md.j2` that stands here is printed where its condition holds: of
the values of the text, by their names. Those of a table are what `fit_tables` gives it.
"""

from collections.abc import Callable, Mapping
from typing import Any

from needlefit.reporting.text import KindText
from needlefit.studies.answer import MAX_NAMED_NEEDLES

RULES: Mapping[str, Callable[[Any], object]] = {
    # what was fitted and predicted
    "about_data": lambda v: not v.folds,
    "about_fits": lambda v: v.folds,
    "in_each_fit": lambda v: v.folds > 1,
    "predicted_insertions": lambda v: v.held_out,
    "depth_of_held_out": lambda v: "validate" in v.depths,
    "nothing_held_out": lambda v: not v.held_out,
    "several_fitted": lambda v: v.fitted_counts != ["1"],
    "one_fitted": lambda v: v.fitted_counts == ["1"],
    "depth_of_fitted": lambda v: "tune" in v.depths,
    "computed": lambda v: v.computation.starts and v.computation.goals,
    "drawn": lambda v: v.computation.source,
    "walkers": lambda v: v.computation.walkers,
    "margin": lambda v: v.run.record.margin_mm,
    # the verdict
    "contradiction": lambda v: v.contradictions,
    "equals_noise": lambda v: v.judged.equals_noise,
    "times_noise": lambda v: v.judged.noise_ratio is not None and not v.judged.equals_noise,
    "closer_reference": lambda v: v.judged.has_reference,
    "hangs_on_few": lambda v: 0 < len(v.judged.compared.hangs_on) <= MAX_NAMED_NEEDLES,
    "hangs_on_many": lambda v: len(v.judged.compared.hangs_on) > MAX_NAMED_NEEDLES,
    "curve_closer": lambda v: not v.judged.has_reference and v.judged.curve_is_closer,
    "closest_curve": lambda v: (
        not (v.judged.has_reference or v.judged.curve_is_closer or v.judged.curve_error is None)
    ),
    "below_margin": lambda v: v.judged.is_within_margin,
    "tracks_closer": lambda v: v.tracks.closer is not None,
}

TEXT = KindText("cross_validation", rules=RULES)
