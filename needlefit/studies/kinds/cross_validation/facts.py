"""The numbers and names that the text of a fit or cross-validation prints."""

from collections import defaultdict
from collections.abc import Iterable, Mapping
from functools import cached_property
from typing import Any

import pandas as pd

from needlefit.inference.baselines import BASELINES
from needlefit.inference.identifiability.precision import UNINFORMED_SD_RATIO
from needlefit.inference.parameters import BEVEL_SPREAD, find_tie_spread, parse_tie
from needlefit.metrics import headline_metrics, list_metrics
from needlefit.reporting.labels import group_name, layers_name, medium_name, method_name
from needlefit.reporting.number_format import format_metric, format_number, join_metrics, join_words
from needlefit.reporting.table_files import Row, to_records
from needlefit.reporting.text import KindText
from needlefit.schemas.medium import ParameterRecord
from needlefit.schemas.study import StudyRecord
from needlefit.studies.coverage import list_coverages, median_error, median_width
from needlefit.studies.identification_tables import describe_verdicts
from needlefit.studies.kinds.cross_validation.posterior import (
    is_ridge,
    list_free_parameters,
    principal_axes,
    tabulate_percentiles,
)
from needlefit.studies.kinds.cross_validation.tables import (
    find_conditional,
    find_fixed,
    find_undetermined,
)
from needlefit.studies.run import Run
from needlefit.studies.scored_groups import (
    TE,
    ScoredGroup,
    list_held_out_groups,
    select_group,
    study_label,
)
from needlefit.studies.summary import aggregate, beats_fit, compare_methods, count_reasons
from needlefit.studies.validity import describe_outside

TEXT = KindText("cross_validation")
PAPER_SETS = ("hand_tuned", "hand_tuned_b")

_ALGORITHMS = {"leastsquares": "nonlinear least squares with the exact Jacobian"}
_PACKAGES = {"python": "Python", "numpy": "NumPy", "scipy": "SciPy", "nlopt": "NLopt"}


def say(results: Run, block: str) -> str:
    """Return a block of the text about a run; empty where it has nothing to say."""
    return TEXT.sentence(block, {"facts": Facts(results)})


def list_sentences(results: Run, *blocks: str) -> list[str]:
    """Return the sentences of some blocks of the text about a run."""
    facts = {"facts": Facts(results)}
    return [sentence for block in blocks for sentence in TEXT.sentences(block, facts)]


def find_scored_role(results: Run) -> str:
    """Return the role that is scored: "validate", or "tune" for a fit without held-out insertions."""
    return "validate" if (results.frames["errors"]["role"] == "validate").any() else "tune"


class Facts:
    """What the text prints of a run; each fact is computed when a sentence needs it."""

    def __init__(self, results: Run) -> None:
        self.results = results
        self.name, self.synthetic = results.name, results.synthetic

    # ---- errors

    @cached_property
    def study(self) -> str:
        label = study_label(self.results)
        return f"Study {label}" if isinstance(label, int) else label

    @cached_property
    def scope(self) -> str:
        return "held-out" if find_scored_role(self.results) == "validate" else "tuning"

    @property
    def headline(self) -> str:
        return join_words([metric.label for metric in headline_metrics()])

    @property
    def aligned(self) -> bool:
        return bool((self.results.frames["errors"]["comparison"] == "aligned").any())

    @cached_property
    def groups(self) -> list[Row]:
        return [self._describe_group(group) for group in list_held_out_groups(self.results)]

    def _describe_group(self, group: ScoredGroup) -> Row:
        head, digits = group.head, 3 if group.head["comparison"] == "aligned" else 2

        def join(column: str) -> str:
            return join_metrics({one.name: group.get(one.name, column) for one in headline_metrics()}, digits)

        study = f"Study {head['study']}, " if isinstance(head["study"], int) else ""
        name = f"{study}{medium_name(head['medium'])}, {layers_name(head['layers'])}"
        known = group.get(TE, "floor") is not None
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
        wanted = (find_scored_role(self.results), "fitted", "measured")
        rows = to_records(aggregate(self.results, ("role", "method", "boundaries")))
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
        role, origin = find_scored_role(self.results), self.results.origin
        return [
            {
                **row,
                "name": method_name(row["method"], origin),
                "curve": row["method"] in BASELINES,
                "paper": row["method"] in PAPER_SETS,
                "wins": beats_fit(row, TE),
            }
            for row in to_records(compare_methods(self.results, role=role, metric=TE))
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
    def _folds(self) -> list[Mapping[str, Any]]:
        return list(self.results.run.get("folds", ()))

    @property
    def folds(self) -> int:
        return len(self._folds)

    @property
    def fitted_counts(self) -> list[str]:
        return _range([len(fold["tune"]) for fold in self._folds])

    @property
    def held_out_count(self) -> int:
        return sum(len(fold["validate"]) for fold in self._folds)

    @cached_property
    def covered_95(self) -> list[Row]:
        return [
            {"what": what, "share": found.hits / found.trials, "hits": found.hits, "trials": found.trials}
            for what, level, found in list_coverages(self.results.frames["predictive"])
            if level == 95 and found.trials
        ]

    @property
    def median_width_mm(self) -> float:
        return median_width(self.results.frames["predictive"])

    @property
    def median_error_mm(self) -> float:
        return median_error(self.results.frames["predictive"])

    @cached_property
    def wide(self) -> list[Row]:
        """The intervals that cover significantly more insertions than their level."""
        return [
            {
                **vars(found),
                **{"what": what, "level": level},
                "group": group_name(group.head["medium"], group.head["layers"]),
            }
            for group in list_held_out_groups(self.results)
            for what, level, found in list_coverages(select_group(self.results.frames["predictive"], group))
            if found.low > level / 100
        ]

    @property
    def draws_of_predictions(self) -> int:
        draws = self.results.frames["predictive"]["draws"]
        return int(draws.max()) if len(draws) else 0

    # ---- parameters

    @cached_property
    def _fitted(self) -> list[Row]:
        frame = self.results.frames["parameters"]
        return to_records(frame[frame["method"] == "fitted"])

    @property
    def has_parameters(self) -> bool:
        return bool(self._fitted)

    @property
    def parameter_folds(self) -> int:
        return len({row["fold"] for row in self._fitted})

    @property
    def free_values(self) -> list[Row]:
        return [row for row in self._fitted if row["status"] != "fixed"]

    @property
    def identified(self) -> bool:
        return len(self.results.frames["identification"]) > 0

    @cached_property
    def undetermined(self) -> list[str]:
        return find_undetermined(self.results)

    @cached_property
    def conditional(self) -> list[str]:
        return find_conditional(self.results)

    @property
    def loose(self) -> list[str]:
        return [name for name in self.undetermined if name not in self.conditional]

    @property
    def fixed(self) -> list[str]:
        return find_fixed(self.results)

    @property
    def determined(self) -> list[tuple[str, list[str]]]:
        """What the data determine, determine under assumptions, and do not determine."""
        names = list(dict.fromkeys(str(row["parameter"]) for row in self.free_values))
        parts = (
            ("identifiable:", [name for name in names if name not in self.undetermined]),
            ("identifiable under assumptions:", self.conditional),
            ("not identifiable:", self.loose),
        )
        return [part for part in parts if part[1]]

    @cached_property
    def by_metric(self) -> bool:
        """Whether the fit minimises errors: by its recipe, or because the data state no noise."""
        starts = self.results.frames["starts"].query("fit == 'fitted'")
        stated = (self.results.run.get("recipe") or {}).get("minimize") == "metric"
        return stated or bool((starts["minimized"] == "metric").any())

    @cached_property
    def unconverged(self) -> list[tuple[str, tuple[str, ...]]]:
        return [(str(n), one.faults) for n, one in self.results.posteriors.items() if one.faults]

    @cached_property
    def outside_fits(self) -> list[Row]:
        rows = to_records(tabulate_percentiles(self.results))
        return [row for row in rows if row["fit_in_central_95"] is False]

    @cached_property
    def drawn(self) -> Row:
        """The draws of the first fold: source, convergence, and their longest direction."""
        every = self.results.frames["draws"]
        fold = every["fold"].iloc[0]
        draws = every[every["fold"] == fold]
        axes = principal_axes(draws[list_free_parameters(self.results)])
        return {
            "count": len(draws),
            "source": str(draws["draw_source"].iloc[0]),
            "pareto_k": float(draws["pareto_k"].iloc[0]),
            "certified": bool(draws["certified"].iloc[0]),
            "folds": int(every["fold"].nunique()),
            "fold": str(fold),
            "ridge": is_ridge(axes),
            "known": axes[0].words,
            "loose": axes[-1].words,
        }

    # ---- the report

    @property
    def printed(self) -> bool:
        """Whether the paper has a row of any held-out group."""
        return any(group["paper"] for group in self.groups)

    @property
    def bands(self) -> bool:
        return len(self.results.frames["bands"]) > 0

    @property
    def no_bands(self) -> bool:
        """Whether bands of held-out insertions are missing because the draws are not certified."""
        certified = self.results.frames["draws"]["certified"].astype(bool).all()
        return not certified and self.scope == "held-out"

    @property
    def anything_scored(self) -> bool:
        return len(self.results.frames["errors"]) > 0

    @property
    def has_methods(self) -> bool:
        return "recipe" in self.results.run  # results that were made up have none

    @property
    def notes(self) -> list[str]:
        """The dataset's notes; that it is synthetic stands on every page."""
        notes = [str(note) for note in self.results.run.get("dataset", {}).get("notes", ())]
        if self.synthetic:
            notes = [note.removeprefix("Synthetic: ") for note in notes]
            notes = [note[:1].upper() + note[1:] for note in notes]
        return notes

    @property
    def freed(self) -> list[str]:
        """What freeing the fixed parameters would change."""
        identification = self.results.frames["identification"]
        return describe_verdicts(identification[identification["status"] == "fixed"])

    # ---- search

    @cached_property
    def failed(self) -> Row:
        starts, failures = self.results.frames["starts"], self.results.frames["failures"]
        reasons = count_reasons(failures).items()
        return {
            "searches": int(starts["failed_solves"].sum()),
            "evaluations": int(starts["evaluations"].sum()),
            "sampled": sum(posterior.failures for posterior in self.results.posteriors.values()),
            "recorded": len(failures),
            "reasons": ", ".join(f"{count} {reason}" for reason, count in reasons),
        }

    @property
    def outside(self) -> str:
        return describe_outside(self.results.run)

    @property
    def agreement(self) -> str:
        """How many starts there are, where all end within tolerance; else nothing."""
        starts = self.results.frames["starts"]
        all_agree = len(starts) and starts["within_tolerance"].astype(bool).all()
        return describe_counts(starts) if all_agree else ""

    @property
    def searches(self) -> list[Row]:
        starts = self.results.frames["starts"]
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
    def direction_folds(self) -> int:
        return int(self.results.frames["directions"]["fold"].nunique())

    @property
    def combinations(self) -> list[tuple[str, list[str]]]:
        """The informed combinations of parameters by fold, in words."""
        directions = self.results.frames["directions"]
        informed = directions[~(directions["sd_ratio"].astype(float) >= UNINFORMED_SD_RATIO)]
        return [(str(n), list(rows["note"])) for n, rows in informed.groupby("fold", sort=False)]

    # ---- methods paragraph

    @property
    def dataset(self) -> str:
        return str(self.results.run.get("dataset", {}).get("name", self.results.dataset_title))

    @property
    def is_twin(self) -> bool:
        return bool(self.results.run.get("dataset", {}).get("name") == "twin")

    @cached_property
    def methods(self) -> Row:
        run, frames = self.results.run, self.results.frames
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
            "from_posterior": bool((predicted["draw_source"] == "posterior").all()),
            "pareto_k": None if pd.isna(pareto) or pareto == float("inf") else float(pareto),
            "specimens": recipe.get("specimens") if new else None,
            "packages": [
                f"{_PACKAGES[name]} {run['versions'][name]}" for name in _PACKAGES if name in run["versions"]
            ],
        }


def describe_counts(starts: pd.DataFrame) -> str:
    """Return the number of starts of each search, and the number of searches, as text."""
    sizes = starts.groupby(["fit", "fold"], sort=False).size()
    each = f"{sizes.min()}" if sizes.min() == sizes.max() else f"{sizes.min()} to {sizes.max()}"
    fits, folds = starts["fit"].nunique(), starts["fold"].nunique()
    where = [f"{folds} folds"] if folds > 1 else []
    where += [f"{fits} searches"] if fits > 1 else []
    return f"{each} starts" + (f" in each of {' × '.join(where)}" if where else "")


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


def _range(counts: Iterable[int]) -> list[str]:
    """Return the least and the greatest of some counts, one if they are equal."""
    ordered = sorted(counts)
    return list(dict.fromkeys(str(count) for count in (*ordered[:1], *ordered[-1:])))


def _choose_digits(value: float | None) -> int:
    return 3 if value is not None and value < 0.1 else 2
