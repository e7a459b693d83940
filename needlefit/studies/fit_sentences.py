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
    # notes of tables of errors
    "row_means": lambda v: "posterior-mode fit" in v.rows,
    "row_ipe": lambda v: v.curved,
    "row_error_minimising": lambda v: "error-minimising fit" in v.rows,
    "by_curves": lambda v: v.curved,
    "by_tips": lambda v: not v.curved,
    "row_prediction": lambda v: "our prediction" in v.rows,
    **dict.fromkeys(("row_medians", "summary_medians"), lambda v: v.medians),
    "row_floor": lambda v: "noise floor" in v.rows,
    "errors_aligned": lambda v: any(one.comparison == "aligned" for one in v.groups),
    "paper_in_world": lambda v: "paper" in v.rows,
    "errors_shifted": lambda v: any(one.comparison == "shifted" for one in v.groups),
    "group_flagged": lambda v: v.head.edp_flagged,
    "group_unflagged": lambda v: v.head.unflagged_edp is not None,
    "group_not_converged": lambda v: v.head.not_converged,
    "beside_paper": lambda v: "paper" in v.rows,
    "summary_flagged": lambda v: any(one.edp_flagged for one in v.groups),
    # notes of the table of coverages
    "and_shapes": lambda v: v.curved,
    "and_bands": lambda v: v.curved,
    "sensors_covered": lambda v: len(v.readings),
    "specimens_spread": lambda v: v.spread,
    "spread_estimated": lambda v: v.spread.specimens,
    "spread_by_prior": lambda v: not v.spread.specimens,
    "spread_of_batch": lambda v: v.spread.batch_recipe,
    # notes of the table of parameters
    "least_errors": lambda v: v.metric,
    "paper_parameters": lambda v: v.printed,
    "population_spread": lambda v: v.population,
    "range_of_folds": lambda v: v.folds > 1,
    "posterior_modes": lambda v: v.modes,
    "posterior_medians": lambda v: v.sources,
    "best_fit": lambda v: not v.sources,
    "and_least_errors": lambda v: v.metric,
    "beside_paper_parameters": lambda v: v.printed,
    "bound_marked": lambda v: v.bounds,
    "known_together": lambda v: v.together,
    "truth": lambda v: v.truth,
    # captions of figures
    "bands_drawn": lambda v: len(v.frames.bands),
    "bands_left_out": lambda v: v.no_bands and not len(v.frames.bands),
    "metrics_explained": lambda v: v.role == "validate",
    "guides_untested": lambda v: v.tracks.untested,
    "tracks_without_bands": lambda v: v.tracks.faults,
    # the report
    "section_predictive": lambda v: len(v.frames.predictive),
    "notes_of_fit": lambda v: v.role == "tune",
    "section_insertions": lambda v: len(v.frames.errors),
    "measured_data": lambda v: not v.run.origin_mark,
    "no_noise": lambda v: not v.floors,
    "noise_floor": lambda v: v.floors,
    "starts_agree": lambda v: v.starts,
    "chains": lambda v: len(v.chains),
    "chains_not_converged": lambda v: not v.chains["converged"].all(),
}

TEXT = KindText("cross_validation", rules=RULES)
