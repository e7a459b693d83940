"""Judge a cross-validation or a fit: errors beside noise floor, baselines and predictive intervals."""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Literal

import pandas as pd

from needlefit.datasets.select import group_independent
from needlefit.inference.baselines import BASELINES
from needlefit.inference.proportions import Proportion, estimate_proportion
from needlefit.project.result_warnings import ResultWarning, read_warnings
from needlefit.reporting.labels import group_name, medium_name
from needlefit.reporting.number_format import format_symbol, join_words
from needlefit.reporting.table_files import to_records
from needlefit.studies.fit_warnings import verdict_warnings
from needlefit.studies.interval_width import find_adaptation, warn_if_too_wide
from needlefit.studies.kinds.cross_validation.parameter_table import find_conditional, find_undetermined
from needlefit.studies.kinds.cross_validation.tables import (
    BY_MEDIA,
    ScoredGroup,
    list_groups,
    list_held_out_groups,
    tabulate_tuning,
)
from needlefit.studies.run import Run
from needlefit.studies.summary import beats_fit, compare_methods
from needlefit.studies.verdict import (
    BestBaseline,
    Status,
    Verdict,
    format_floor_ratio,
    format_tip_error,
    judge_errors,
    qualify,
)

_TE = "te_mm"


def judge(results: Run) -> list[Verdict]:
    """Return a verdict for each held-out group; of a fit, for each medium fitted to."""
    groups = [] if results.kind == "fit" else list_held_out_groups(results)
    if groups:
        media = [group.head["medium"] for group in groups]
        return [_judge_held_out(results, group, media.count(group.head["medium"]) > 1) for group in groups]
    tuning = tabulate_tuning(results)
    groups = list_groups(tuning[tuning["grouping"] == BY_MEDIA])
    return [_judge_fit(results, group) for group in groups] or [
        Verdict("No fit: no start of the search has a solution for every insertion", "fail")
    ]


def _judge_held_out(results: Run, group: ScoredGroup, named_layers: bool) -> Verdict:
    medium, layers = group.head["medium"], group.head["layers"]
    name = group_name(medium, layers) if named_layers else medium_name(medium)
    numbers = _collect_numbers(group)
    error = group.get(_TE)
    if error is None:
        return Verdict(f"Not scored: no simulation on {name} converged", "fail", name, numbers)
    best = _compare_best(results, group)
    floor_ratio, count = group.over_floor(_TE), int(group.head["insertions"])
    found = judge_errors(name, error, floor_ratio, best, count, reliable=results.reliable)
    predictive = _select_group(results.frames["predictive"], group)
    if len(predictive):
        numbers["predictive_median_te_mm"] = median = median_error(predictive)
        sentence = f"{found.sentence}; predictive median: {format_tip_error(median)}"
        closer = best is not None and best.error_mm is not None and best.error_mm < median
        found = qualify(found, sentence) if closer else replace(found, sentence=sentence)
    found = replace(found, group=name, numbers=numbers)
    missed = _describe_missed(predictive)
    found = qualify(found, f"{found.sentence}; {missed}") if missed else found
    if any(one.kind == "noise_too_large" for one in read_warnings(results.run)):
        found = qualify(found, f"{found.sentence}; the stated noise is too large")
    return found


def _compare_best(results: Run, group: ScoredGroup) -> BestBaseline | None:
    """Return the best baseline of a group and whether it is significantly better or worse than the fit."""
    best = find_best_baseline(group)
    if best is None:
        return None
    here = results.with_frames(errors=_select_group(results.frames["errors"], group))
    error = group.get(_TE, method=best)
    verdict: Literal["better", "worse", "tie"] = (
        "better" if _beats(here, best, "fitted") else "worse" if _beats(here, "fitted", best) else "tie"
    )
    return BestBaseline(BASELINES[best].description, error, verdict)


def _beats(results: Run, method: str, other: str) -> bool:
    """Return whether the tip errors of a method are significantly smaller than those of another."""
    rows = to_records(compare_methods(results, against=other, metric=_TE))
    return any(beats_fit(row, _TE) for row in rows if row["method"] == method)


def find_best_baseline(group: ScoredGroup) -> str | None:
    """Return the baseline with the smallest tip error."""
    errors = {name: group.get(_TE, method=name) for name in BASELINES.names()}
    known = {name: error for name, error in errors.items() if error is not None}
    return min(known, key=lambda name: known[name], default=None)


def _select_group(frame: pd.DataFrame, group: ScoredGroup) -> pd.DataFrame:
    inside = (frame["medium"] == group.head["medium"]) & (frame["layers"] == group.head["layers"])
    members: pd.DataFrame = frame[inside]
    return members


def count_covered(predictive: pd.DataFrame, column: str) -> Proportion:
    """Return how many insertions lie in their predicted interval; `column` is such as "tip_in_95"."""
    independent = group_independent(list(predictive["insertion"]), list(predictive["specimen"]))
    return estimate_proportion(list(predictive[column]), independent)


def list_coverages(predictive: pd.DataFrame) -> Iterator[tuple[str, int, Proportion]]:
    """Yield "tip" or "shape", level (%) and share of insertions that the interval covers."""
    if not predictive.empty:
        for level in (95, 50):
            for what in ("tip", "shape"):
                yield what, level, count_covered(predictive, f"{what}_in_{level}")


def list_missed_levels(predictive: pd.DataFrame) -> list[tuple[str, int, Proportion]]:
    """Return the intervals that cover too few insertions, as `list_coverages`.

    That is where the 95 % confidence interval of the share lies below the level.
    """
    return [one for one in list_coverages(predictive) if one[2].high < one[1] / 100]


_TOO_NARROW = "the intervals are too narrow: they do not include model error"
_CENTRE_OFF = "this interval is too narrow or its centre is wrong; the 95 % interval covers enough of them"


def warn_of_coverage(results: Run) -> Iterator[ResultWarning]:
    """Yield the intervals of held-out insertions that cover too few of them, by group."""
    for group in list_held_out_groups(results):
        rows = _select_group(results.frames["predictive"], group)
        missed, alone = list_missed_levels(rows), rows["specimen"].nunique() == 1
        narrow = {what for what, level, _ in missed if level == 95}
        for what, level, found in missed:
            share = _describe_share(found, what, group)
            yield ResultWarning(
                "coverage",
                f"the {level} % predictive interval covers {share}{' in one specimen' if alone else ''}",
                fix=_TOO_NARROW if what in narrow else _CENTRE_OFF,
            )


def median_width(predictive: pd.DataFrame) -> float:
    """Return the median width of the 95 % intervals of tips, mm."""
    return float((predictive["tip_95_high_mm"] - predictive["tip_95_low_mm"]).median())


def median_error(predictive: pd.DataFrame) -> float:
    """Return the mean distance of the medians of predicted tips from the measured ones, mm.

    That is the tip error of the predictions; `te_mm` is of the posterior mode.
    """
    return float((predictive["tip_median_mm"] - predictive["tip_measured_mm"]).abs().mean())


def warn_of_width(results: Run) -> Iterator[ResultWarning]:
    """Yield the held-out groups whose tips have wide intervals: wider than the tips are deflected."""
    for group in list_held_out_groups(results):
        rows = _select_group(results.frames["predictive"], group)
        deflection = float(rows["tip_measured_mm"].abs().median())
        where, fix = medium_name(group.head["medium"]), _describe_gain(results, group)
        yield from warn_if_too_wide(median_width(rows), deflection, where, fix)


def _describe_gain(results: Run, group: ScoredGroup) -> str:
    """Return what one insertion into a new specimen gains; empty where the specimen is not new."""
    rows = _select_group(results.frames["predictive"], group)
    if not (rows["specimen_treatment"] == "others").any():
        return ""
    name = find_adaptation(
        results.record.dataset, getattr(results.record, "medium", ""), group.head["medium"]
    )
    study = f" (`needlefit validate {name}`)" if name else ""
    return f"{describe_after_one(rows)}; a study of kind adaptation{study} measures the gain"


def describe_after_one(predictive: pd.DataFrame) -> str:
    """Return how wide the intervals of tips would be after one insertion into the new specimen."""
    width = float(predictive["tip_95_width_after_one_mm"].median())
    about = "narrower" if math.isnan(width) else f"about {width:.2g} mm wide"
    return (
        f"after one measured insertion into the new specimen (its tip alone) they would be {about}, if the "
        "model is right there"
    )


def describe_evidence(results: Run) -> str:
    """Return what a verdict rests on: insertions fitted to and held out, coverage of the 95 % intervals,
    and their width.
    """
    folds = results.run.get("folds", ())
    fitted = sorted({len(fold["tune"]) for fold in folds})
    counts = " to ".join(dict.fromkeys(str(count) for count in (*fitted[:1], *fitted[-1:])))
    each = f" in each of {len(folds)} folds" if len(folds) > 1 else ""
    held_out = sum(len(fold["validate"]) for fold in folds)
    parts = [f"Fitted: n = {counts}{each}"] if folds else []
    parts += [f"Held out: n = {held_out}"] if held_out else []
    covered = [
        f"{100 * found.hits / found.trials:.0f} % of {'tips' if what == 'tip' else 'whole shapes'} "
        f"({found.hits} of {found.trials})"
        for what, level, found in list_coverages(results.frames["predictive"])
        if level == 95 and found.trials
    ]
    width = median_width(results.frames["predictive"]) if covered else 0.0
    error = median_error(results.frames["predictive"]) if covered else 0.0
    wide = f"those of tips are {width:.2g} mm wide (median), their medians {error:.2g} mm off (mean)"
    parts += [f"The 95 % predictive intervals cover {join_words(covered)}; {wide}"] if covered else []
    return "".join(f"{one}. " for one in parts).strip()


def describe_wide_intervals(results: Run) -> list[str]:
    """Return a sentence for each interval that covers significantly more insertions than its level."""
    return [
        f"The {level} % predictive interval is wider than needed: it covers "
        f"{_describe_share(found, what, group)}."
        for group in list_held_out_groups(results)
        for what, level, found in list_coverages(_select_group(results.frames["predictive"], group))
        if found.low > level / 100
    ]


def _describe_share(found: Proportion, what: str, group: ScoredGroup) -> str:
    """Return how many tips or shapes of a group are covered, with the confidence interval of the share."""
    where = group_name(group.head["medium"], group.head["layers"])
    ends = f"{100 * found.low:.0f} to {100 * found.high:.0f} %"
    return f"{found.hits} of {found.trials} {what}s on {where} (95 % CI of the share {ends})"


def _describe_missed(predictive: pd.DataFrame) -> str:
    """Return the first interval that covers too few insertions; empty if none does."""
    for what, level, found in list_missed_levels(predictive):
        return f"the {level} % interval covers {found.hits} of {found.trials} {what}s"
    return ""


def _collect_numbers(group: ScoredGroup) -> dict[str, float | str | None]:
    best = find_best_baseline(group)
    return {
        _TE: group.get(_TE),
        "floor_te_mm": group.get(_TE, "floor"),
        "te_over_floor": group.over_floor(_TE),
        "baseline": best,
        "baseline_te_mm": None if best is None else group.get(_TE, method=best),
        "paper_te_mm": group.get(_TE, "paper"),
        "insertions": group.head["insertions"],
    }


def _judge_fit(results: Run, group: ScoredGroup) -> Verdict:
    """Return the verdict on a fit: how closely it follows its insertions, what it determines."""
    count, name = group.head["insertions"], medium_name(group.head["medium"])
    what = "insertion" if count == 1 else f"{count} insertions"
    numbers = {**_collect_numbers(group), "not_determined": ", ".join(find_undetermined(results))}
    kinds = {one.kind for one in verdict_warnings(results.run)}
    error = group.get(_TE)
    if error is None:
        return Verdict(f"No fit: no simulation on {name} converged", "fail", name, numbers)
    ratio = group.over_floor(_TE)
    opening, status = _open_fit(kinds, bool(numbers["not_determined"]), ratio, results.reliable)
    errors = f"TE {format_tip_error(error)} on the {what} fitted to{format_floor_ratio(ratio)}"
    return Verdict(f"{opening}: {errors}; {_describe_determined(results)}", status, name, numbers)


def _open_fit(
    kinds: set[str], undetermined: bool, floor_ratio: float | None, reliable: bool
) -> tuple[str, Status]:
    if "worse_than_baseline" in kinds and (floor_ratio is None or floor_ratio > 1):
        return "Does not fit", "fail"
    if "parameter_at_bound" in kinds:
        return "Fitted, but at a bound", "warn"
    if not reliable:
        return "Fitted, but not reliable", "warn"
    if "worse_than_baseline" in kinds:
        return "Fitted, but a baseline is closer", "warn"
    return ("Fitted in part", "warn") if undetermined else ("Fitted", "pass")


def _describe_determined(results: Run) -> str:
    rows = results.frames["parameters"].query("method == 'fitted' and status != 'fixed'")
    names, loose = list(dict.fromkeys(rows["parameter"])), find_undetermined(results)
    conditional = find_conditional(results)
    known = [name for name in names if name not in loose]
    loose = [name for name in loose if name not in conditional]
    parts = [
        f"{words} {join_words([format_symbol(name).split(' (')[0] for name in some])}"
        for words, some in (
            ("identifiable:", known),
            ("identifiable under assumptions:", conditional),
            ("not identifiable:", loose),
        )
        if some
    ]
    return "; ".join(parts) or "all parameters are fixed"
