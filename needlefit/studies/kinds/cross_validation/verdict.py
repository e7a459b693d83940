"""Judge a cross-validation or a fit: tip errors beside noise floor, baselines and predictive intervals."""

from dataclasses import replace

from needlefit.project.result_warnings import read_warnings
from needlefit.reporting.labels import group_name, medium_name, method_name
from needlefit.reporting.table_files import Row
from needlefit.studies.coverage import list_missed_levels, median_error
from needlefit.studies.kinds.cross_validation.facts import PAPER_SETS, TEXT, Facts
from needlefit.studies.run import Run
from needlefit.studies.scored_groups import (
    HELD_OUT,
    TE,
    ScoredGroup,
    compare_best_baseline,
    compare_group,
    find_best_baseline,
    list_judged_groups,
    select_group,
)
from needlefit.studies.verdict import Status, Verdict, judge_errors, qualify


def judge(results: Run) -> list[Verdict]:
    """Return a verdict for each held-out group; of a fit, for each medium fitted to."""
    groups = list_judged_groups(results)
    media = [group.head["medium"] for group in groups]
    return [
        _judge_held_out(results, group, media.count(group.head["medium"]) > 1)
        if group.head["grouping"] == HELD_OUT
        else _judge_fit(results, group)
        for group in groups
    ] or [Verdict("No fit: no start of the search has a solution for every insertion", "fail")]


def _judge_held_out(results: Run, group: ScoredGroup, named_layers: bool) -> Verdict:
    medium, layers = group.head["medium"], group.head["layers"]
    name = group_name(medium, layers) if named_layers else medium_name(medium)
    numbers = _collect_numbers(group)
    error = group.get(TE)
    if error is None:
        return Verdict(f"Not scored: no simulation on {name} converged", "fail", name, numbers)
    best = compare_best_baseline(results, group)
    floor_ratio, count = group.over_floor(TE), int(group.head["insertions"])
    judged = judge_errors(name, error, floor_ratio, best, count, reliable=results.reliable)
    predictive = select_group(results.frames["predictive"], group)
    median = median_error(predictive) if len(predictive) else None
    numbers |= {} if median is None else {"predictive_median_te_mm": median}
    missed = [
        {"what": what, "level": level, "hits": found.hits, "trials": found.trials}
        for what, level, found in list_missed_levels(predictive)
    ]
    noisy = any(one.kind == "noise_too_large" for one in read_warnings(results.run))
    values = {
        **{"judged": judged, "median_mm": median, "noisy": noisy},
        "missed": missed[0] if missed else None,
        "paper_set": _find_closer_set(results, group, error),
    }
    nearest = None if best is None else best.error_mm
    closer = nearest is not None and median is not None and nearest < median
    found = replace(judged, sentence=TEXT.sentence("held_out", values), group=name, numbers=numbers)
    return qualify(found, found.sentence) if closer or missed or noisy else found


def _find_closer_set(results: Run, group: ScoredGroup, error: float) -> Row | None:
    """Return the set of the paper's that is closest, if it is closer than the fit on most insertions."""
    rows = [
        {
            "name": f"the {method_name(row['method'], results.origin)}".replace(", b", " with b"),
            "error_mm": row[TE],
            "closer": row["insertions"] - row["better"],
            "insertions": row["insertions"],
        }
        for row in compare_group(results, group)
        if row["method"] in PAPER_SETS and row[TE] is not None
    ]
    closer = [row for row in rows if row["error_mm"] < error and 2 * row["closer"] > row["insertions"]]
    return min(closer, key=lambda row: float(row["error_mm"]), default=None)


def _collect_numbers(group: ScoredGroup) -> dict[str, float | str | None]:
    best = find_best_baseline(group)
    return {
        TE: group.get(TE),
        "floor_te_mm": group.get(TE, "floor"),
        "te_over_floor": group.over_floor(TE),
        "baseline": best,
        "baseline_te_mm": None if best is None else group.get(TE, method=best),
        "paper_te_mm": group.get(TE, "paper"),
        "insertions": group.head["insertions"],
    }


def _judge_fit(results: Run, group: ScoredGroup) -> Verdict:
    """Return the verdict on a fit: how closely it follows its insertions, what it determines."""
    name, error, facts = medium_name(group.head["medium"]), group.get(TE), Facts(results)
    numbers = {**_collect_numbers(group), "not_determined": ", ".join(facts.undetermined)}
    if error is None:
        return Verdict(f"No fit: no simulation on {name} converged", "fail", name, numbers)
    ratio, kinds = group.over_floor(TE), {one.kind for one in read_warnings(results.run)}
    opening, status = _open_fit(kinds, bool(facts.undetermined), ratio, results.reliable)
    values = {"facts": facts, "opening": opening, "error_mm": error, "floor_ratio": ratio}
    values |= {"insertions": group.head["insertions"]}
    return Verdict(TEXT.sentence("fitted", values), status, name, numbers)


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
