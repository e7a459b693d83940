"""The report of a fit or cross-validation: what its text prints, verdicts, figures, files.

The tables are those of `tables.py`; the sentences stand in `reporting/text/cross_validation.md.j2`.
"""

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from needlefit.arrays import Floats
from needlefit.datasets.select import group_rows
from needlefit.grouping import group_values
from needlefit.inference.baselines import BASELINES
from needlefit.inference.identifiability.directions import (
    DETERMINED,
    UNINFORMED_SD_RATIO,
    find_least_determined,
)
from needlefit.inference.parameters import BEVEL_SPREAD, find_tie_spread, is_logarithmic, parse_tie
from needlefit.inference.predict import estimate_proportion
from needlefit.metrics import headline_metrics, list_metrics
from needlefit.project.result_warnings import read_warnings
from needlefit.reporting import document, labels, latex
from needlefit.reporting.columns import DIGITS, METRIC_FORMAT, find_column, format_value
from needlefit.reporting.figures import Drawing, Look
from needlefit.reporting.figures import fit_forms as forms
from needlefit.reporting.needle_page import PageData
from needlefit.reporting.number_format import (
    choose_interval_unit,
    format_metric,
    format_mm,
    format_number,
    insert_symbols,
    join_metrics,
    join_words,
    typeset,
    typeset_interval,
)
from needlefit.reporting.table import TableLayout
from needlefit.reporting.table_files import Row, to_records, to_tidy, write_csv
from needlefit.schemas.medium import ParameterRecord
from needlefit.schemas.study import StudyRecord
from needlefit.studies import scored_groups as scores
from needlefit.studies.coverage import (
    is_too_wide,
    judge_predictions,
    list_coverages,
    median_width,
    tip_error_of_medians,
)
from needlefit.studies.explorer import collect_explorer
from needlefit.studies.fit_frames import COLUMNS as FRAMES
from needlefit.studies.fit_frames import list_methods, select_draws, select_fitted, select_free
from needlefit.studies.identification_tables import (
    describe_verdicts,
    lay_out_identification,
    tabulate_identification,
)
from needlefit.studies.kinds.cross_validation import tables
from needlefit.studies.rank_statistics import ecdf_band
from needlefit.studies.report import StudyReport
from needlefit.studies.run import Run, Status, Verdict, judge_errors, judge_run, once_per_run, qualify
from needlefit.studies.slicer import write_needles
from needlefit.studies.validity import describe_outside

__all__ = ["FRAMES", "REPORT"]

PAPER_SETS = ("hand_tuned", "hand_tuned_b")

_ALGORITHMS = {"leastsquares": "nonlinear least squares with the exact Jacobian"}
_PACKAGES = {"python": "Python", "numpy": "NumPy", "scipy": "SciPy", "nlopt": "NLopt"}


def list_sentences(results: Run, *blocks: str) -> list[str]:
    """Return the sentences of some blocks of the text about a run."""
    return [
        sentence for block in blocks for sentence in tables.TEXT.sentences(block, collect_values(results))
    ]


def find_scored_role(results: Run) -> str:
    """Return the role that is scored: "validate", or "tune" for a fit without held-out insertions."""
    return "validate" if (results.frames["errors"]["role"] == "validate").any() else "tune"


class Facts:
    """What the text prints of a run; each fact is computed when a sentence needs it."""

    def __init__(self, results: Run) -> None:
        self.results, self.frames = results, results.frames
        self.has_methods = "recipe" in results.run  # results that were made up have none
        self.outside = describe_outside(results.run)
        self.headline = join_words([metric.label for metric in headline_metrics()])
        self.role = find_scored_role(results)
        self.scope = "held-out" if self.role == "validate" else "tuning"
        label = scores.study_label(results)
        self.study = f"Study {label}" if isinstance(label, int) else label
        about = results.run.get("dataset", {})
        self.dataset = str(about.get("name", results.dataset_title))
        folds = list(results.run.get("folds", ()))
        counts = sorted(len(fold["tune"]) for fold in folds)
        self.folds, self.held_out_count = len(folds), sum(len(fold["validate"]) for fold in folds)
        depths = results.frames["errors"].query("method == 'fitted'").groupby("role")["depth_mm"]
        self.depths = {role: (float(found.min()), float(found.max())) for role, found in depths}
        # the least and the greatest, one if they are equal
        self.fitted_counts = list(dict.fromkeys(map(str, (*counts[:1], *counts[-1:]))))
        fitted = to_records(results.frames["parameters"].query("method == 'fitted'"))
        self.parameter_folds = len({row["fold"] for row in fitted})
        self.free_values = [row for row in fitted if row["status"] != "fixed"]
        self.fixed = _name(row for row in fitted if row["status"] == "fixed")  # given, not estimated
        # of several folds the one counts in which a parameter is determined least
        least = {
            name: find_least_determined(
                str(row["determined"]) for row in self.free_values if row["parameter"] == name
            )
            for name in _name(self.free_values)
        }
        known, self.together, self.loose = (
            [name for name, found in least.items() if found == word] for word in DETERMINED
        )
        parts = {"determined:": known, "only together:": self.together, "not determined:": self.loose}
        self.determined = [(words, names) for words, names in parts.items() if names]
        notes = list(map(str, about.get("notes", ())))
        if results.synthetic:  # that it is stands on every page
            notes = [note.removeprefix("Synthetic: ") for note in notes]
            notes = [note[:1].upper() + note[1:] for note in notes]
        self.notes = notes

    # ---- errors

    @cached_property
    def groups(self) -> list[Row]:
        return [self._describe_group(group) for group in scores.list_held_out_groups(self.results)]

    def _describe_group(self, group: scores.ScoredGroup) -> Row:
        head, digits = group.head, 3 if group.head["comparison"] == "aligned" else 2

        def join(column: str) -> str:
            return join_metrics({one.name: group.get(one.name, column) for one in headline_metrics()}, digits)

        study = f"Study {head['study']}, " if isinstance(head["study"], int) else ""
        name = f"{study}{labels.medium_name(head['medium'])}, {labels.layers_name(head['layers'])}"
        known = group.get(scores.TE, "floor") is not None
        return {
            "name": name[:1].upper() + name[1:],
            "insertions": head["insertions"],
            "errors": join("value"),
            "floors": join("floor") if known else "",
            "paper": join("paper") if group.printed else "",
        }

    @cached_property
    def _scores(self) -> dict[str, Row]:
        """The fitted model's errors over everything it is scored on, by metric; empty if it was not."""
        wanted = (self.role, "fitted", "measured")
        rows = to_records(scores.aggregate(self.frames["errors"], ("role", "method", "boundaries")))
        return {r["metric"]: r for r in rows if (r["role"], r["method"], r["boundaries"]) == wanted}

    @cached_property
    def scored(self) -> Row:
        if not self._scores:
            return {}
        values = {metric.name: self._scores[metric.name]["value"] for metric in headline_metrics()}
        errors = join_metrics(values, _choose_digits(self._scores["ipe_mean_mm"]["value"]))
        return {"errors": errors, "insertions": self._scores["ipe_mean_mm"]["insertions"]}

    @cached_property
    def floors(self) -> list[str]:
        """Each metric's noise floor; none where no noise is stated."""
        floor = self._scores["ipe_mean_mm"]["floor"] if self._scores else None
        if floor is None:
            return []
        digits = _choose_digits(floor)
        return [
            f"{one.label} {format_metric(one, self._scores[one.name]['floor'], digits)} {one.unit}"
            for one in list_metrics()
            if one.has_floor
        ]

    # ---- comparison with baselines and with the paper's sets, by tip error

    @cached_property
    def compared(self) -> list[Row]:
        """Every other method beside the fit; `wins` if its tip error is significantly smaller."""
        return [
            {
                **row,
                "name": labels.method_name(row["method"], self.results.origin),
                "curve": row["method"] in BASELINES,
                "paper": row["method"] in PAPER_SETS,
                "wins": scores.beats_fit(row, scores.TE),
            }
            for row in to_records(scores.compare_methods(self.results, role=self.role, metric=scores.TE))
            if row["method"] != "fitted"
        ]

    @property
    def curves(self) -> list[Row]:
        return [row for row in self.compared if row["curve"]]

    @property
    def better(self) -> list[Row]:
        return [row for row in self.compared if row["wins"]]

    @property
    def ties(self) -> list[Row]:
        return [row for row in self.compared if (row["difference_mm"] or 0.0) < 0 and not row["wins"]]

    @property
    def closest(self) -> Row | None:
        known = [row for row in self.curves if row["difference_mm"] is not None]
        return min(known, key=lambda row: float(row["difference_mm"]), default=None)

    # ---- predictions

    @cached_property
    def intervals(self) -> Row:
        """How many insertions the 95 % intervals cover, and the width and error of those of tips."""
        predictive = self.frames["predictive"]
        covered = [
            {"what": what, "share": found.hits / found.trials, "hits": found.hits, "trials": found.trials}
            for what, level, found in list_coverages(predictive)
            if level == 95 and found.trials
        ]
        width, deflection = median_width(predictive), float(predictive["tip_measured_mm"].abs().median())
        return {
            "covered": covered,
            "width_mm": width,
            "deflection_mm": deflection,
            "too_wide": is_too_wide(width, deflection),
            "error_mm": tip_error_of_medians(predictive),
        }

    @property
    def draws_of_predictions(self) -> int:
        draws = self.frames["predictive"]["draws"]
        return int(draws.max()) if len(draws) else 0

    @cached_property
    def by_metric(self) -> bool:
        """Whether the fit minimises errors: by its recipe, or because the data state no noise."""
        starts = self.frames["starts"].query("fit == 'fitted'")
        stated = (self.results.run.get("recipe") or {}).get("minimize") == "metric"
        return stated or bool((starts["minimized"] == "metric").any())

    @cached_property
    def unconverged(self) -> list[tuple[str, tuple[str, ...]]]:
        return [(str(n), one.faults) for n, one in self.results.posteriors.items() if one.faults]

    @cached_property
    def outside_fits(self) -> list[Row]:
        rows = to_records(tables.tabulate_percentiles(self.results))
        return [row for row in rows if row["fit_in_central_95"] is False]

    @cached_property
    def drawn(self) -> Row:
        """The draws of the first fold: source, convergence, and their longest direction."""
        draws = select_draws(self.frames["draws"])
        axes = tables.principal_axes(draws[tables.list_free_parameters(self.results)])
        return {
            "count": len(draws),
            "source": str(draws["draw_source"].iloc[0]),
            "pareto_k": float(draws["pareto_k"].iloc[0]),
            "certified": bool(draws["certified"].iloc[0]),
            "folds": int(self.frames["draws"]["fold"].nunique()),
            "fold": str(draws["fold"].iloc[0]),
            # beside the mean and a new specimen each has draws of its own
            "separate": self.frames["draws"]["specimen"].nunique() > 2,
            "ridge": tables.is_ridge(axes),
            "known": axes[0].words,
            "loose": axes[-1].words,
        }

    # ---- the report

    @property
    def printed(self) -> bool:
        """Whether the paper has a row of any held-out group."""
        return any(group["paper"] for group in self.groups)

    @property
    def no_bands(self) -> bool:
        """Whether bands of held-out insertions are missing because the draws are not certified."""
        certified = self.frames["draws"]["certified"].astype(bool).all()
        return not certified and self.scope == "held-out"

    @property
    def freed(self) -> list[str]:
        """What freeing the fixed parameters would change."""
        return describe_verdicts(self.frames["identification"].query("status == 'fixed'"))

    # ---- search

    @cached_property
    def failed(self) -> Row:
        starts, failures = self.frames["starts"], self.frames["failures"]
        reasons = scores.count_reasons(failures).items()
        return {
            "searches": int(starts["failed_solves"].sum()),
            "evaluations": int(starts["evaluations"].sum()),
            "sampled": sum(posterior.failures for posterior in self.results.posteriors.values()),
            "recorded": len(failures),
            "reasons": ", ".join(f"{count} {reason}" for reason, count in reasons),
        }

    @property
    def agreement(self) -> str:
        """How many starts there are, where all end within tolerance; else nothing."""
        starts = self.frames["starts"]
        all_agree = len(starts) and starts["within_tolerance"].astype(bool).all()
        return describe_counts(starts) if all_agree else ""

    @property
    def searches(self) -> list[Row]:
        starts = self.frames["starts"]
        return [
            {
                "fold": str(fold),
                "best": float(rows["objective"].min()),
                "agree": int(rows["within_tolerance"].sum()),
                "starts": len(rows),
                "posterior": bool((rows["minimized"] == "posterior").all()),
                "ended": int((rows["stopped"] == "budget").sum()),
            }
            for fold, rows in starts[starts["fit"] == "fitted"].groupby("fold", sort=False)
        ]

    @property
    def combinations(self) -> list[tuple[str, list[str]]]:
        """The informed combinations of parameters by fold, in words."""
        directions = self.frames["directions"]
        informed = directions[~(directions["sd_ratio"].astype(float) >= UNINFORMED_SD_RATIO)]
        return [(str(n), list(rows["note"])) for n, rows in informed.groupby("fold", sort=False)]

    # ---- methods paragraph

    @cached_property
    def methods(self) -> Row:
        run, frames = self.results.run, self.frames
        recipe, parameters, how = run["recipe"], run["medium"]["parameters"], run["recipe"]["likelihood"]
        stored = how.get("measurement", "stored") == "stored" and how["noise"] == "correlated"
        shared = (run["dataset"]["boundary_shared_sd_mm"] or ()) if how["depths"] != "fixed" else ()
        predicted, by_angle = frames["predictive"], "cut_angle_deg" in parameters
        pareto = frames["draws"]["pareto_k"].max()
        new = (predicted["specimen_treatment"] == "others").any()
        return {
            **{"recipe": recipe, "rules": run["rules"], "versions": run["versions"]},
            "law": str(run["rules"]["law"]).capitalize(),
            "bevel": "cut angle" if by_angle else "bevel offset",
            "symbol": "θ" if by_angle else "b",
            "free": [name for name, one in parameters.items() if one["bounds"]],
            "held": [name for name, one in parameters.items() if one["fixed"] is not None],
            "ties": _group_ties(parameters, self.by_metric),
            "measurement": run["dataset"]["measurement"],
            "compared": stored or run["dataset"]["measurement"]["operator"] == "none",
            "shared_sd_mm": list(dict.fromkeys(map(format_number, (*shared[:1], *shared[-1:])))),
            "spread": bool((frames["parameters"]["parameter"] == BEVEL_SPREAD).any()),
            "algorithm": " and then ".join(
                _ALGORITHMS.get(part, part.upper()) for part in recipe["algorithm"].split("+")
            ),
            "is_study": isinstance(self.results.record, StudyRecord),
            "distinct_held_out": len({one for fold in run["folds"] for one in fold["validate"]}),
            "first_draws": int(predicted["draws"].iloc[0]) if len(predicted) else 0,
            "folds": predicted["fold"].nunique(),
            "sampled_folds": predicted[predicted["draw_source"] == "posterior"]["fold"].nunique(),
            "pareto_k": None if pd.isna(pareto) or pareto == float("inf") else float(pareto),
            "specimens": recipe.get("specimens") if new else None,
            "packages": [
                f"{_PACKAGES[name]} {run['versions'][name]}" for name in _PACKAGES if name in run["versions"]
            ],
        }


@once_per_run
def collect_values(results: Run) -> dict[str, Any]:
    """Return what the text prints."""
    return {"facts": Facts(results)}


def describe_counts(starts: pd.DataFrame) -> str:
    """Return the number of starts of each search, and the number of searches, as text."""
    sizes = starts.groupby(["fit", "fold"], sort=False).size()
    each = f"{sizes.min()}" if sizes.min() == sizes.max() else f"{sizes.min()} to {sizes.max()}"
    fits, folds = starts["fit"].nunique(), starts["fold"].nunique()
    where = [f"{folds} folds"] if folds > 1 else []
    where += [f"{fits} searches"] if fits > 1 else []
    return f"{each} starts" + (f" in each of {' × '.join(where)}" if where else "")


def _name(rows: Iterable[Row]) -> list[str]:
    """Return the parameters of some rows, each once."""
    return list(dict.fromkeys(str(row["parameter"]) for row in rows))


def _group_ties(
    parameters: Mapping[str, Mapping[str, Any]], exact_alone: bool
) -> list[tuple[float | None, list[Row]]]:
    """Return tied parameters by the spread of their prior; None: exactly tied."""
    groups: defaultdict[float | None, list[Row]] = defaultdict(list)
    for name, how in parameters.items():
        if (tie := how.get("tie")) is not None:
            factor, source = parse_tie(name, tie)
            spread = find_tie_spread(name, ParameterRecord(tie=tie, spread=how.get("spread")))
            exact = spread == 1 or exact_alone
            groups[None if exact else spread].append({"name": name, "factor": factor, "source": source})
    return sorted(groups.items(), key=lambda item: item[0] is not None)


def _choose_digits(value: float | None) -> int:
    return 3 if value is not None and value < 0.1 else 2


# ---- verdicts: tip errors beside noise floor, baselines and predictive intervals


def judge(results: Run) -> list[Verdict]:
    """Return a verdict for each held-out group; of a fit, for each medium fitted to."""
    groups = scores.list_judged_groups(results)
    media = [group.head["medium"] for group in groups]
    return [
        _judge_held_out(results, group, media.count(group.head["medium"]) > 1)
        if group.head["grouping"] == scores.HELD_OUT
        else _judge_fit(results, group)
        for group in groups
    ] or [Verdict("No fit: no start of the search has a solution for every insertion", "fail")]


def _judge_held_out(results: Run, group: scores.ScoredGroup, named_layers: bool) -> Verdict:
    medium, layers = group.head["medium"], group.head["layers"]
    name = labels.group_name(medium, layers) if named_layers else labels.medium_name(medium)
    numbers = _collect_numbers(group)
    error = group.get(scores.TE)
    if error is None:
        return Verdict(f"Not scored: no simulation on {name} converged", "fail", name, numbers)
    best = scores.compare_best_baseline(results, group)
    floor_ratio, count = group.over_floor(scores.TE), int(group.head["insertions"])
    judged = judge_errors(name, error, floor_ratio, best, count, reliable=results.reliable)
    predictive = scores.select_group(results.frames["predictive"], group)
    noisy = any(one.kind == "noise_too_large" for one in read_warnings(results.run))
    values = {"judged": judged, "noisy": noisy, "paper_set": _find_closer_set(results, group, error)}
    found = replace(judged, sentence=tables.TEXT.sentence("held_out", values), group=name, numbers=numbers)
    found = judge_predictions(found, predictive, best)
    return qualify(found, found.sentence) if noisy else found


def _find_closer_set(results: Run, group: scores.ScoredGroup, error: float) -> Row | None:
    """Return the set of the paper's that is closest, if it is closer than the fit on most insertions."""
    rows = [
        {
            "name": f"the {labels.method_name(row['method'], results.origin)}".replace(", b", " with b"),
            "error_mm": row[scores.TE],
            "closer": row["insertions"] - row["better"],
            "insertions": row["insertions"],
        }
        for row in scores.compare_group(results, group)
        if row["method"] in PAPER_SETS and row[scores.TE] is not None
    ]
    closer = [row for row in rows if row["error_mm"] < error and 2 * row["closer"] > row["insertions"]]
    return min(closer, key=lambda row: float(row["error_mm"]), default=None)


def _collect_numbers(group: scores.ScoredGroup) -> dict[str, float | str | None]:
    best = scores.find_best_baseline(group)
    return {
        scores.TE: group.get(scores.TE),
        "floor_te_mm": group.get(scores.TE, "floor"),
        "te_over_floor": group.over_floor(scores.TE),
        "baseline": best,
        "baseline_te_mm": None if best is None else group.get(scores.TE, method=best),
        "paper_te_mm": group.get(scores.TE, "paper"),
        "insertions": group.head["insertions"],
    }


def _judge_fit(results: Run, group: scores.ScoredGroup) -> Verdict:
    """Return the verdict on a fit: how closely it follows its insertions, what it determines."""
    name, error, facts = (
        labels.medium_name(group.head["medium"]),
        group.get(scores.TE),
        collect_values(results)["facts"],
    )
    numbers = {**_collect_numbers(group), "not_determined": ", ".join([*facts.together, *facts.loose])}
    if error is None:
        return Verdict(f"No fit: no simulation on {name} converged", "fail", name, numbers)
    ratio, kinds = group.over_floor(scores.TE), {one.kind for one in read_warnings(results.run)}
    opening, status = _open_fit(kinds, bool(facts.together or facts.loose), ratio, results.reliable)
    values = {"facts": facts, "opening": opening, "error_mm": error, "floor_ratio": ratio}
    values |= {"insertions": group.head["insertions"]}
    return Verdict(tables.TEXT.sentence("fitted", values), status, name, numbers)


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


# ---- figures: insertions

_POINT_COLUMNS = [*forms.INSERTION_KEYS, "curve", "x_mm", *forms.HEIGHT_COLUMNS]
MAX_LARGE_PANELS = 24  #: insertions at most whose panels are large

_OVERLAY_POINT_STEP = 5  # of the points compared, one in so many is drawn


def collect_curves(results: Run, role: str, shown: Iterable[str], every: int = 1) -> pd.DataFrame:
    """Return one row per drawn point of a role's insertions; y is toward the bevel, mm.

    `curve` is a method of `shown`, "measured" (of the points, one in `every`), or the level of a band, which
    held-out insertions have: `low_mm`, `high_mm` are its ends.
    """
    where = "role == @role and boundaries == 'measured' and method in @shown"
    shapes = results.frames["shapes"].query(where, local_dict={"role": role, "shown": list(shown)})
    shapes = shapes.sort_values([*forms.INSERTION_KEYS, "method", "j"])
    simulated = shapes.set_axis([c.replace("simulated_", "") for c in shapes.columns], axis=1)
    dots = shapes.drop_duplicates([*forms.INSERTION_KEYS, "j"])
    bands = _align_bands(results.frames["bands"], dots)
    dots = dots[dots["j"] % every == 0].set_axis([c.replace("measured_", "") for c in shapes.columns], axis=1)
    parts = [simulated.assign(curve=simulated["method"]), dots.assign(curve="measured")]
    for level in forms.BANDS if role == "validate" else ():
        number = level.removesuffix(" %")
        ends = {f"low_{number}_mm": "low_mm", f"high_{number}_mm": "high_mm"}
        parts.append(bands.rename(columns=ends).assign(curve=level))
    found = pd.concat(
        [part.reindex(columns=_POINT_COLUMNS) for part in parts if len(part)], ignore_index=True
    )
    sides = found["insertion"].map(scores.find_bevel_sides(results))
    found[forms.HEIGHT_COLUMNS] = found[forms.HEIGHT_COLUMNS].mul(sides, axis=0)
    return found.assign(origin=results.origin)


def _align_bands(bands: pd.DataFrame, shapes: pd.DataFrame) -> pd.DataFrame:
    """Return bands as they lie about the measured needle that is drawn.

    Where only the shape is known, scores turn it into a frame of their own: a band stays where it is beside
    the needle it was predicted for.
    """
    parts = []
    ends = [name for name in bands.columns if name.startswith(("low_", "high_"))]
    for key, band in bands.groupby(forms.INSERTION_KEYS, sort=False):
        needle = shapes[(shapes["fold"] == key[0]) & (shapes["insertion"] == key[1])]
        if len(needle):
            height = np.interp(band["x_mm"], needle["measured_x_mm"], needle["measured_y_mm"])
            parts.append(band.assign(**{name: band[name] - band["measured_mm"] + height for name in ends}))
    return pd.concat(parts) if parts else bands


def _title_panels(results: Run, role: str) -> dict[forms.InsertionKey, str]:
    """Return by fold and insertion what stands above its panel: its tip error."""
    titles = {}
    for row in to_records(select_fitted(results.frames["errors"], role)):
        error = f"{format_mm(row['te_mm'], 3 if row['comparison'] == 'aligned' else 2)} mm"
        titles[row["fold"], row["insertion"]] = error if row["converged"] else "did not converge"
    return titles


def _rank_by_tip_error(results: Run, role: str) -> list[forms.InsertionKey]:
    """Return the insertions of a role by the tip error of the fit, smallest first."""
    rows = select_fitted(results.frames["errors"], role).query("converged")
    rows = rows.sort_values("te_mm", kind="stable")
    return list(rows[forms.INSERTION_KEYS].itertuples(index=False, name=None))


def _select(points: pd.DataFrame, chosen: Iterable[forms.InsertionKey]) -> pd.DataFrame:
    inside = pd.MultiIndex.from_frame(points[forms.INSERTION_KEYS]).isin(list(chosen))
    selected: pd.DataFrame = points[inside]
    return selected


def draw_insertions(results: Run, role: str) -> dict[str, Drawing]:
    """Return all insertions; the best and the worst in their layers."""
    titles = _title_panels(results, role)
    names = {method: labels.method_name(method) for method in ("fitted", "hand_tuned")}
    every = _OVERLAY_POINT_STEP if len(titles) <= MAX_LARGE_PANELS else 2 * _OVERLAY_POINT_STEP
    ranked = _rank_by_tip_error(results, role)
    ends = {"Only insertion": ranked[0]} if len(ranked) == 1 else {"Best": ranked[0], "Worst": ranked[-1]}
    heads = {which: f"{word}: TE {titles[which]}" for word, which in ends.items()}
    best = collect_curves(results, role, ("fitted",), _OVERLAY_POINT_STEP)
    best = pd.concat([_select(best, heads), _list_layers(results, heads)], ignore_index=True)
    return {
        "schematic": Drawing(
            forms.insertions,
            best,
            {"heads": heads, "names": {"fitted": names["fitted"]}, "most_columns": 2, "layers": True},
        ),
        "overlays": Drawing(
            forms.insertions, collect_curves(results, role, names, every), {"heads": titles, "names": names}
        ),
    }


def _list_layers(results: Run, chosen: Iterable[forms.InsertionKey]) -> pd.DataFrame:
    """Return a row for each layer of some insertions: `curve` is its name, `x_mm` where it begins."""
    stored = results.run.get("layers", {})
    rows = [
        {"fold": fold, "insertion": insertion, "curve": f"{forms.LAYER} {layer:.0f}", "x_mm": float(begin)}
        for fold, insertion in chosen
        for layer, begin in stored.get(insertion, [(1, 0.0)])
    ]
    return pd.DataFrame(rows).assign(origin=results.origin)


# ---- errors on held-out groups

#: fewer tip errors than this are shown as points only: a box of them would be an invention
_MIN_TIPS_OF_BOX = 5

_BOXPLOT_COLUMNS = ("group", "metric", "mark", "insertion", "value", "origin")


def draw_errors(results: Sequence[Run]) -> dict[str, Drawing]:
    """Return the errors on held-out insertions by group, and the predictive check.

    Of several studies also the errors of every method; nothing where none is held out.
    """
    if scores.tabulate_validation(*results).empty:
        return {}
    marks = pd.DataFrame([row for one in results for row in _list_boxes(one)], columns=_BOXPLOT_COLUMNS)
    drawn = {"boxplot": Drawing(forms.errors_by_group, marks)}
    if len(results) > 1:  # of one study the table of methods has these numbers
        drawn["baselines"] = _draw_baselines(results)
    if any(len(one.frames["predictive"]) for one in results):
        drawn["predicted"] = Drawing(forms.predictive_check, tabulate_predictive_check(results))
    return drawn


def _list_boxes(results: Run) -> Iterator[Row]:
    """Yield what ends, halves and quarters a box, tips, means, floor and the paper's means."""
    cloud, errors = map(select_fitted, (scores.tabulate_points(results), results.frames["errors"]))
    for group in scores.list_held_out_groups(results):
        medium, layers = group.head["medium"], group.head["layers"]
        about = {"group": f"{_name_group(group)}, n = {group.head['insertions']}", "origin": results.origin}
        ipe, te = (
            frame[(frame["medium"] == medium) & (frame["layers"] == layers) & np.isfinite(frame[column])]
            for frame, column in ((cloud, "ipe_mm"), (errors, scores.TE))
        )
        yield from ({**about, "metric": "IPE", **mark} for mark in _list_quartiles(ipe["ipe_mm"]))
        if len(te) >= _MIN_TIPS_OF_BOX:
            yield from ({**about, "metric": "TE", **mark} for mark in _list_quartiles(te[scores.TE]))
        for tip in to_records(te[["insertion", scores.TE]]):
            place = {"mark": "tip", "insertion": tip["insertion"], "value": tip[scores.TE]}
            yield {**about, "metric": "TE", **place}
        for error, metric in (("IPE", "ipe_mean_mm"), ("TE", scores.TE)):
            for mark, column in (("mean", "value"), ("noise floor", "floor"), ("paper", "paper")):
                if (value := group.get(metric, column)) is not None:
                    yield {**about, "metric": error, "mark": mark, "value": value}


def _name_group(group: scores.ScoredGroup) -> str:
    study, medium = labels.study_name(group.head["study"]), labels.medium_name(group.head["medium"])
    return f"{study}, {medium}, {labels.layers_name(group.head['layers'])}"


def _list_quartiles(values: "pd.Series[float]") -> list[Row]:
    if not len(values):
        return []
    ends = np.percentile(values.to_numpy(dtype=np.float64), list(forms.QUARTILES.values()))
    return [{"mark": mark, "value": float(end)} for mark, end in zip(forms.QUARTILES, ends, strict=True)]


def _draw_baselines(results: Sequence[Run]) -> Drawing:
    """Return one row per held-out group with a mark per method, the paper's and the noise floor."""
    rows = [
        {
            "group": _name_group(group),
            "method": method,
            scores.TE: value,
            "origin": group.head["origin"],
        }
        for group in scores.list_held_out_groups(*results)
        for method, value in (
            *((method, group.get(scores.TE, method=method)) for method in list_methods()),
            *(
                ("paper", group.get(scores.TE, "paper")),
                ("noise floor", group.get(scores.TE, "floor")),
            ),
        )
        if value is not None
    ]
    frame = pd.DataFrame(rows, columns=["group", "method", scores.TE, "origin"])
    present = [method for method in list_methods() if (frame["method"] == method).any()]
    middle, step = (len(present) - 1) / 2, 0.6 / max(len(present) - 1, 1)
    looks = {
        method: Look(
            labels.method_name(method),
            labels.method_colour(method),
            labels.method_marker(method),
            shift=step * (place - middle),
            size=5.5 if method == "fitted" else 4,
        )
        for place, method in enumerate(present)
    }
    looks["paper"] = Look("paper, own needles", labels.PAPER_COLOUR, "D", filled=False, size=4)
    looks["noise floor"] = Look("noise floor", labels.INK, "|", dashes=(0, (2, 1.5)), width=0.9)
    options: dict[str, Any] = {
        "rows": ("group",),
        "value": scores.TE,
        "by": "method",
        "looks": looks,
        "scale": "log",
    }
    options |= {
        "name_row": lambda row: row[0].replace(", ", "\n"),
        "x_label": "mean tip error (mm)",
        "row_height": 0.5,
    }
    return Drawing("dots_with_intervals", frame, options)


# ---- predictive check

BAND_POINTS = 100  #: number of probabilities at which the band is computed, plus one
BAND_ERROR_PROBABILITY = 0.05  #: probability that uniform PIT values leave the band somewhere

_CHECK_COLUMNS = (
    *("study", "mark", "quantity", "probability", "share", "low", "high"),
    *("insertions", "replicates", "origin"),
)


def tabulate_predictive_check(results: Sequence[Run]) -> pd.DataFrame:
    """Return steps of the ECDFs of PIT values, their band, and shares with Wilson intervals.

    The PIT value of a measurement is the probability that was predicted of less: of a tip less far toward
    the bevel, of a shape nearer at its worst point. Where predictions are right it is uniform. A needle is
    one trial; depths of one hole are one, and so are all in one specimen where there are specimens enough
    (`group_independent`).
    """
    rows = [row for one in results if len(one.frames["predictive"]) for row in _list_checks(one)]
    return pd.DataFrame(rows, columns=_CHECK_COLUMNS)


def _list_checks(results: Run) -> Iterator[Row]:
    predictions = results.frames["predictive"]
    groups = group_rows(predictions)
    trials = len(set(groups))
    about: Row = {"study": labels.study_name(scores.study_label(results)), "origin": results.origin}
    about |= {"insertions": len(predictions), "replicates": trials}
    size = pd.Series(groups).map(pd.Series(groups).value_counts()).to_numpy(dtype=np.float64)
    for quantity, pits in _orient_pits(results).items():
        order = np.argsort(pits, kind="stable")
        below = np.cumsum(1 / size[order]) / trials  # every group weighs the same
        for level, part in zip([0.0, *pits[order], 1.0], [0.0, *below, 1.0], strict=True):
            place = {"quantity": quantity, "probability": float(level), "share": float(part)}
            yield {**about, "mark": "ECDF", **place}
    low, high = (ends / trials for ends in ecdf_band(trials, BAND_POINTS, BAND_ERROR_PROBABILITY))
    for number, (least, most) in enumerate(zip(low, high, strict=True), start=1):
        band = {"probability": number / BAND_POINTS, "low": float(least), "high": float(most)}
        yield {**about, "mark": "band", **band}
    for quantity in forms.PREDICTED_QUANTITIES:
        for level in forms.PREDICTED_LEVELS:
            found = estimate_proportion(list(map(bool, predictions[f"{quantity}_in_{level}"])), groups)
            ends = {"share": found.hits / found.trials, "low": found.low, "high": found.high}
            yield {**about, "mark": "coverage", "quantity": quantity, "probability": level / 100, **ends}


def _orient_pits(results: Run) -> dict[str, Floats]:
    """Return the levels of tips and shapes; those of tips are stored toward +y."""
    predictions = results.frames["predictive"]
    sides = predictions["insertion"].map(scores.find_bevel_sides(results)).to_numpy(dtype=np.float64)
    tips, shapes = (predictions[f"{name}_pit"].to_numpy(dtype=np.float64) for name in ("tip", "shape"))
    # The PIT value of -y is 1 minus that of y: needles whose bevels face opposite sides become comparable.
    return {"tip": np.where(sides > 0, tips, 1 - tips), "shape": shapes}


# ---- search and draws

_END_COLUMNS = ("parameter", "value", "bound_low", "bound_high", "between_bounds")


def draw_starts(results: Run) -> Drawing:
    """Return the objective of all starts above the best one, and where each parameter ended."""
    return Drawing(
        forms.waterfall, _tabulate_starts(results), {"title": describe_counts(results.frames["starts"])}
    )


def _tabulate_starts(results: Run) -> pd.DataFrame:
    """Return one row per start and free parameter: rank, objective minus best, and final value.

    Ranks are within a search, best first; starts without a result have none. Only of the fit itself are the
    parameters' ends drawn, so those of other searches are left out.
    """
    starts = results.frames["starts"].astype({"excess": float, "objective": float})
    finite = starts["excess"].where(np.isfinite(starts["excess"]))
    starts["rank"] = finite.groupby([starts["fold"], starts["fit"]], sort=False).rank(method="first")
    free = to_records(select_free(results.frames["parameters"]).drop_duplicates("parameter"))
    head, rows = ("fold", "fit", "start", "rank", "excess", "within_tolerance"), []
    for start in to_records(starts):
        row = {key: start[key] for key in head} | {"failed": start["objective"] is None}
        shown = free if start["fit"] == "fitted" else []
        rows += [row | _find_end(start, one) for one in shown] or [row]
    columns = [*head, "failed", *_END_COLUMNS]
    return pd.DataFrame(rows, columns=columns).assign(origin=results.origin)


def _find_end(start: Row, free: Row) -> Row:
    """Return where a parameter ended, 0 to 1 between its bounds; moduli and lengths in logarithms."""
    name, ends = free["parameter"], (free["bound_low"], free["bound_high"])
    value, share = start[name], None
    if value is not None:
        at, low, high = (math.log(one) if is_logarithmic(name) else one for one in (value, *ends))
        share = (at - low) / (high - low)
    return dict(zip(_END_COLUMNS, (name, value, *ends, share), strict=True))


def _tabulate_marks(results: Run) -> pd.DataFrame:
    """Return what is drawn, Pa and mm: one row per draw, fit, paper's set, bound and end of the ridge."""
    fold = results.frames["draws"]["fold"].iloc[0]
    names = tables.list_free_parameters(results)
    draws = select_draws(results.frames["draws"])[names].assign(mark="draw")
    known = results.frames["parameters"][results.frames["parameters"]["fold"] == fold]
    values = known.pivot_table(index="method", columns="parameter", values="value", sort=False)
    sets = [method for method in forms.DRAWN_SETS if method in values.index]
    bounds = known[known["method"] == "fitted"].set_index("parameter")[["bound_low", "bound_high"]].T
    marks = [
        values.loc[sets].reindex(columns=names).assign(mark=sets),
        bounds.reindex(columns=names).assign(mark=["lower bound", "upper bound"]),
        pd.DataFrame(tables.find_ridge_ends(draws[names])).assign(mark="ridge"),
    ]
    frame = pd.concat([draws, *(part for part in marks if len(part))], ignore_index=True)
    drawn: pd.DataFrame = frame[["mark", *names]]
    return drawn.assign(origin=results.origin)


# ---- what the HTML page computes


def collect_page_data(results: Run) -> PageData | None:
    """Return the data of the interactive part of the page; None where nothing was scored."""
    scored = select_fitted(results.frames["errors"], find_scored_role(results))
    scored = scored[scored["converged"].astype(bool)]
    return collect_explorer(results, scored, {one.group: one.status for one in judge_run(results)})


# ---- sentences


def explain(results: Run) -> tuple[list[TableLayout], list[str]]:
    """Return all tables, and sentences on the search, on what failed and on what the data determine."""
    shown = [
        *lay_out_tables(results),
        tables.lay_out_baselines(results, find_scored_role(results)),
    ]
    shown += [tables.lay_out_coverage(results)] if len(results.frames["predictive"]) else []
    shown += [tables.lay_out_posterior(results)] if results.posteriors else []
    held_out = bool(scores.list_held_out_groups(results))
    errors = ["groups" if held_out else "fit", "conclusion"]
    errors += ["better_others", "ties"] if held_out else ["paper_sets"]
    groups = results.frames["identification"].groupby("fold", sort=False)
    verdicts = {str(fold): describe_verdicts(rows) for fold, rows in groups}
    sentences = [
        *list_sentences(results, *errors, "noise_floor", "prediction_set", "searches"),
        *list_sentences(results, "combinations"),
        *map(insert_symbols, _name_folds(verdicts)),
        *list_sentences(results, "failures", "validity", "unconverged", "outside_fits"),
    ]
    return shown, sentences


def _name_folds(found: Mapping[str, Sequence[str]]) -> Iterator[str]:
    """Yield the sentences of folds, each once, with the folds that it holds for unless these are all."""
    pairs = ((sentence, fold) for fold, sentences in found.items() for sentence in sentences)
    for sentence, folds in group_values(pairs).items():
        several = "Folds" if len(folds) > 1 else "Fold"
        yield sentence if len(folds) == len(found) else f"{several} {', '.join(folds)}: {sentence}"


# ---- tables


def tabulate_files(result: Run) -> dict[str, pd.DataFrame]:
    """Return the tables that are written as CSV, by name."""
    names = ("design", "errors", "shapes", "starts", "failures", "directions")
    frames = {name: result.frames[name] for name in names}
    frames |= {name: result.frames[name] for name in ("error_fit", "population") if len(result.frames[name])}
    predictions = [result.frames[name] for name in ("predictive", "predictive_training")]
    if any(map(len, predictions)):
        frames["predictive"] = pd.concat([frame for frame in predictions if len(frame)])
    frames |= {name: frame for name, frame, _ in _lay_out_own_files(result) if len(frame)}
    if len(result.frames["identification"]):
        frames["identify"] = tabulate_identification(result.frames["identification"], result.origin)
    if result.posteriors:
        frames["posterior"] = tables.tabulate_percentiles(result)
    return frames


def fit_to_json(result: Run) -> dict[str, Any]:
    """Return the errors beside the paper's; of a fit also its parameters, starts and what they determine."""
    frames = {"validation": scores.tabulate_validation(result)}
    if result.kind == "fit":
        names = ("errors", "starts", "failures", "error_fit", "directions", "identification", "profiles")
        frames = {
            "parameters": tables.tabulate_parameters(result),
            **{name: result.frames[name] for name in names},
        }
        if result.posteriors:
            frames["posterior"] = tables.tabulate_percentiles(result)
    return {name: to_records(to_tidy(frame)) for name, frame in frames.items()}


def lay_out_tables(result: Run) -> list[TableLayout]:
    """Return the tables of errors and parameters beside the paper's."""
    return [table for _, _, layouts in _lay_out_own_files(result) for table in layouts if table.rows]


@once_per_run
def _lay_out_own_files(result: Run) -> list[tuple[str, pd.DataFrame, list[TableLayout]]]:
    return list(lay_out_files([result], [result]))


def lay_out_files(
    studies: Sequence[Run], tunings: Sequence[Run]
) -> Iterator[tuple[str, pd.DataFrame, list[TableLayout]]]:
    """Yield the paper's tables with our rows beside its rows: name, rows, and the tables to print."""
    every = list({one.name: one for one in (*studies, *tunings)}.values())
    validation = scores.tabulate_validation(*studies, with_alternate=True)
    yield "validation", validation, [tables.lay_out_validation(studies)]
    by = [tables.lay_out_tuning(tunings, grouping) for grouping in (scores.BY_LAYERS, scores.BY_MEDIA)]
    yield "tuning", scores.tabulate_tuning(*tunings, with_alternate=True), by
    yield "parameters", tables.tabulate_parameters(*every), [tables.lay_out_parameters(every)]


@once_per_run
def _list_tables(results: Run) -> list[TableLayout]:
    """Return the tables of a report but its first ones."""
    role = find_scored_role(results)
    *errors, parameters = (table for _, _, layouts in _lay_out_own_files(results) for table in layouts)
    baselines = tables.lay_out_baselines(results, role)
    return [
        tables.lay_out_design([results]),
        *errors,
        *([tables.lay_out_coverage(results)] if len(results.frames["predictive"]) else []),
        *([baselines] if len(baselines.rows) > 1 else []),
        parameters,
        tables.lay_out_directions(results),
        *([tables.lay_out_population(results)] if len(results.frames["population"]) else []),
        *(
            [lay_out_identification(results.frames["identification"])]
            if len(results.frames["identification"])
            else []
        ),
        *([tables.lay_out_posterior(results)] if results.posteriors else []),
        tables.lay_out_insertions(results, role),
    ]


@once_per_run
def _lay_out_summary(results: Run) -> TableLayout:
    return tables.lay_out_summary([results])


def lay_out_first(results: Run) -> list[TableLayout]:
    """Return the tables of the first page: parameters, then errors; of a study its held-out groups first."""
    if find_scored_role(results) == "tune":
        return [tables.lay_out_values(results), tables.lay_out_in_sample(results)]
    return [_lay_out_summary(results), tables.lay_out_values(results)]


# ---- files


def write_files(result: Run, folder: Path) -> None:
    """Write the numbers and methods for a paper, and every needle in its scan."""
    # With every digit: it is exactly these values that fail again.
    write_csv(result.frames["failures"].assign(origin=result.origin), folder / "failures.csv", digits=None)
    if len(result.frames["needles"]):
        write_needles(result.frames["needles"], result.synthetic, folder / "slicer")
    (folder / "numbers.tex").write_text(format_macros([result]), encoding="utf-8")
    if collect_values(result)["facts"].has_methods:
        lines, cited = format_methods(result)
        (folder / "methods.tex").write_text(lines, encoding="utf-8")
        (folder / "references.bib").write_text(format_references(cited), encoding="utf-8")


def format_methods(result: Run) -> tuple[str, list[str]]:
    """Return the methods paragraph as LaTeX, and the keys of `references.bib` that it cites."""
    values = collect_values(result)
    parts = [tables.TEXT.format_latex(block, values) for block in ("methods_data", "methods")]
    cited = dict.fromkeys(key for _, keys in parts for key in keys)
    return "\n".join(lines for lines, _ in parts if lines) + "\n", list(cited)


_REFERENCES_HEAD = (
    "% Cited by methods.tex. Needs \\usepackage{url} and, at the end, \\bibliographystyle and "
    "\\bibliography{references}."
)


def format_references(cited: Sequence[str]) -> str:
    """Return the BibTeX entries of these keys, which ship with needlefit."""
    text = (files("needlefit.reporting") / "templates" / "references.bib").read_text(encoding="utf-8")
    entries = [entry.strip() for entry in text.split("\n\n") if entry.strip()]
    known = {entry.split("{", 1)[1].split(",", 1)[0]: entry for entry in entries}
    return "\n\n".join([_REFERENCES_HEAD, *(known[key] for key in cited)]) + "\n"


def format_macros(results: Sequence[Run]) -> str:
    """Return a LaTeX file of macros of errors and parameters, by readable keys.

    A key is `<run>-<medium>-<layers>-<error>`, with `floor-` or `paper-` before the error for what stands
    beside it or `-over-floor` after it for the multiple of its noise floor; `<run>-<parameter>`, the median
    of the posterior, with `-low`, `-high` and `-interval` of its 95 % interval, all in the unit of the
    tables, `-unit`, and `-determined`.
    """
    return latex.format_macros(
        number
        for one in results
        for numbers in (_list_errors(one), _list_parameters(one))
        for number in numbers
    )


def _list_errors(results: Run) -> Iterator[tuple[str, str]]:
    for group in scores.list_held_out_groups(results):
        head = group.head
        begin = f"{results.name}-{head['medium']}-{head['layers']}"
        yield f"{begin}-n", str(head["insertions"])
        for metric in list_metrics():
            row = {"metric": metric.name, DIGITS: 3 if head["comparison"] == "aligned" else 2}
            for key, column in (("", "value"), ("floor-", "floor"), ("paper-", "paper")):
                value = group.get(metric.name, column)
                if value is not None or not key:
                    yield f"{begin}-{key}{metric.macro_name}", format_value(METRIC_FORMAT, value, row)
            if (times := group.over_floor(metric.name)) is not None:
                words = find_column("over_floor").format_cell({"over_floor": times})
                yield f"{begin}-{metric.macro_name}-over-floor", words


def _list_parameters(results: Run) -> Iterator[tuple[str, str]]:
    table = tables.arrange_parameters(tables.tabulate_parameters(results))
    several = len({row["fold"] for row in table}) > 1
    for row in table:
        name = str(row["parameter"]).removesuffix("_pa").removesuffix("_mm").replace("_", "-")
        where = f"-{row['fold']}" if several else ""
        key = f"{results.name}{where}-{name}"
        estimate = tables.choose_estimate(row)
        assert estimate is not None
        label, scale = choose_interval_unit(row, estimate)
        yield key, typeset(format_number(estimate / scale))
        if unit := label.partition(" (")[2].rstrip(")"):
            yield f"{key}-unit", unit
        if row["determined"]:
            yield f"{key}-determined", str(row["determined"])
        if interval := typeset_interval(row, scale):
            yield f"{key}-interval", interval
            low, _, high = interval.partition(" to ")
            yield from ((f"{key}-low", low), (f"{key}-high", high))


# ---- the report


def list_figures(results: Run) -> dict[str, Drawing]:
    """Return what the tables allow to be drawn."""
    role, frames = find_scored_role(results), results.frames
    found: dict[str, Drawing] = {}
    both = [frames[name] for name in ("errors", "shapes")]
    if all(((one["role"] == role) & (one["method"] == "fitted")).any() for one in both):
        found |= draw_insertions(results, role)
    if len(frames["draws"]) and tables.list_free_parameters(results):
        names = {"fitted": "the fit", "hand_tuned": labels.method_name("hand_tuned", results.origin)}
        found["corner"] = Drawing(
            forms.corner, _tabulate_marks(results), {"names_of_sets": names}, optional=True
        )
    if len(frames["starts"]) and not collect_values(results)["facts"].agreement:
        found["waterfall"] = draw_starts(results)
    if len(frames["profiles"]):
        found["profiles"] = forms.draw_profiles(frames["identification"], frames["profiles"], results.origin)
    return found | draw_errors([results])


def tuning_tables(results: Sequence[Run]) -> list[TableLayout]:
    """Return the in-sample tables; by media only where the paper has a cell."""
    groups = scores.list_groups(scores.tabulate_tuning(*results))
    printed = any(group.head["grouping"] == scores.BY_MEDIA and group.printed for group in groups)
    groupings = (scores.BY_LAYERS, scores.BY_MEDIA) if printed else (scores.BY_LAYERS,)
    return [tables.lay_out_tuning(results, by) for by in groupings if groups]


REPORT = StudyReport(
    tables.TEXT,
    collect_values,
    lay_out_tables,
    list_figures,
    blocks=lambda results: {
        "methods": [document.text(" ".join(list_sentences(results, "methods")))]
        if collect_values(results)["facts"].has_methods
        else []
    },
    more_tables=lambda results: [
        *_list_tables(results),
        _lay_out_summary(results),
        tables.lay_out_all_errors(results),
    ],
    tabulate=tabulate_files,
    write_files=write_files,
    to_json=fit_to_json,
    judge=judge,
    explore=collect_page_data,
    lay_out_first=lay_out_first,
    explain=explain,
)
