"""The tables of fits and cross-validations, of one run or of several; captions stand in the text."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from needlefit.grouping import group_values
from needlefit.inference.identifiability.directions import (
    MAX_LOG_SD,
    UNINFORMED_SD_RATIO,
    find_least_determined,
)
from needlefit.inference.parameter_names import BEVEL_PARAMETERS, HYPERPARAMETERS, is_logarithmic
from needlefit.inference.sampling.posterior import PERCENTILES
from needlefit.metrics import IPE, Metric, headline_metrics, list_metrics
from needlefit.reporting.labels import SPECIMEN_NAMES, medium_name, method_name
from needlefit.reporting.number_format import (
    choose_printed_unit,
    choose_unit,
    format_bare_symbol,
    format_metric,
    format_plain,
    is_known,
    round_significant,
)
from needlefit.reporting.table import DIGITS, Cells, Table, TableLayout, part, pivot
from needlefit.reporting.table_files import Row, select_rows, to_records
from needlefit.reporting.text import KindText
from needlefit.schemas.run_metadata import FitMetadata, JobMetadata, RigidityMetadata
from needlefit.studies import scored_groups as scores
from needlefit.studies.identification import FROM_PRIOR, ParameterRow, describe_prior
from needlefit.studies.judge import MAX_NOISE_RATIO, REFERENCES, judge
from needlefit.studies.prediction_scores import COVERAGE_COLUMNS, tabulate_coverage
from needlefit.studies.run import NEW_SPECIMEN, TUNED_SPECIMENS, FitFrames, Run, value_of_run

#: sentences of fits and cross-validations
TEXT = KindText("cross_validation")


def _lay_out(table: Table, drop_empty: bool = False, **values: object) -> TableLayout:
    return TEXT.lay_out(table, values, drop_empty)


# ---- errors by group: ours above the paper's, one column per quantity


@dataclass(frozen=True)
class _RowKind:
    """A kind of row in a table of errors: its name, and where its numbers stand in a `ScoredGroup`."""

    name: str
    method: str = "fitted"
    column: str = "value"


_FLOOR, _PAPER = _RowKind("noise floor", column="floor"), _RowKind("paper", column="paper")


def _list_kinds(*methods: str) -> list[_RowKind]:
    return [_RowKind(method_name(method), method) for method in methods]


def lay_out_errors(name: str, *runs: Run) -> TableLayout:
    """Return the errors by group (ours, noise floor, paper): "validation" held out, "tuning" in-sample."""
    heads = ("study", "medium", "layers", "insertions")[len(runs) == 1 :]
    blocks = []
    for run in runs:
        ours = ("fitted",) if name == "tuning" else (FitFrames.of(run).method, "fitted_metric", "b_alone")
        kinds = (*_list_kinds(*ours), _FLOOR, _PAPER)
        blocks += [(group, kinds) for group in scores.list_groups(run, name)]
    return _lay_out_groups(name, blocks, heads, medians=_count_medians(runs))


@value_of_run
def lay_out_summary(run: Run) -> TableLayout:
    """Return the errors of the first page: ours, those of the compared curves, of the paper.

    They are means over the insertions of the verdict, held out or fitted to; those by medium and number of
    layers are in the table "validation". The paper's parameters are scored on our data; its result is of its
    own needles.
    """
    frames, fitted_to = FitFrames.of(run), str(run.record.medium)
    groups = scores.list_groups(run) or scores.list_groups(run, "tuning")
    group = groups[0] if len(groups) == 1 else scores.pool_insertions(run)
    if group is None:
        return Table("summary", [], ("row",)).lay_out()
    of_other = "" if {group.medium for group in groups} == {fitted_to} else f" for {medium_name(fitted_to)}"
    curves, judged = [*REFERENCES], judge(run)
    if judged and judged.curve and judged.curve not in curves:
        curves.append(judged.curve)
    kinds = (
        *_list_kinds(frames.method, *curves),
        _RowKind(f"our needles, simulated with the paper's parameters{of_other}", "hand_tuned"),
        _RowKind("paper's result, on its own needles", column="paper"),
    )
    table = _lay_out_groups("summary", [(group, kinds)], (), short=True, medians=_count_medians([run]))
    count, (first, *others) = group.insertions, table.columns
    which = "held-out" if frames.role == "validate" else "fitted"
    words = f"Mean over {count} {which} insertion{'s' * (count != 1)}"
    return replace(table, columns=(replace(first, label=words), *others))


def _lay_out_groups(
    name: str,
    blocks: Sequence[tuple[scores.ScoredGroup, Sequence[_RowKind]]],
    heads: Sequence[str],
    medians: int,
    short: bool = False,
) -> TableLayout:
    """Return a block of rows for each group, of which the first has its name (`heads`) and its noise.

    A `short` table has the errors of sentences, that of the verdict first, and the noise of tips; else all,
    and as multiples of the noise.
    """
    rows, by_tips = list[Row](), all(group.score == scores.TE for group, _ in blocks)
    for number, (group, kinds) in enumerate(blocks):
        noise = group.get(scores.TE, "floor")
        for kind in kinds:
            described = [_describe_score(group, kind, metric) for metric in list_metrics()]
            about = {**_head(group), "number": number, "noise_of_te": noise if kind is kinds[0] else None}
            if any(row["value"] is not None for row in described):
                rows += [about | row for row in described]
    shown = {row["metric"] for row in rows if row["value"] is not None and not math.isnan(row["value"])}
    metrics = [metric for metric in list_metrics() if metric.name in shown and not metric.spread_of]
    if short:
        metrics = [metric for metric in metrics if metric.headline or metric.relative]
    floors = [metric.name for metric in metrics if metric.headline and metric.has_floor]
    last: list[str | Cells] = [part("over_floor", metric=name) for name in floors]
    last = ["noise_of_te"] if short and by_tips else last
    if short:
        metrics.sort(key=lambda metric: not metric.missed)
    columns = (*heads, "row", *(part("metric_value", metric=metric.name) for metric in metrics), *last)
    lines = pivot(rows, ["number", "row"], ["metric"])
    table = Table(name, lines, columns, groups=("number",), heads=len(heads), strong="groups")
    heads_of_groups = [_head(group) for group, _ in blocks]
    names = {row["row"] for row in rows}
    about = {"groups": heads_of_groups, "curved": IPE.name in shown, "medians": medians}
    return _lay_out(table, short, rows=names, **about)


def _count_medians(runs: Sequence[Run]) -> int:
    """Return of how many insertions the prediction is the predictive median."""
    return sum(len(run.knows(FitMetadata).medians) for run in runs)


def _describe_score(group: scores.ScoredGroup, kind: _RowKind, metric: Metric) -> Row:
    where = {"column": kind.column, "method": kind.method}
    value = group.get(metric.name, **where)
    fine = group.comparison == "aligned" or (value or 1) < 0.1  # as in the verdict
    digits = 3 if fine and kind.column != "paper" else 2
    spread = next((other for other in list_metrics() if other.spread_of == metric.name), None)
    flagged = metric.relative and group.edp_flagged and kind.column != "paper" and value is not None
    is_value = kind.column == "value"
    return {
        **{"row": kind.name, "metric": metric.name, "value": value, "mark": "†" if flagged else ""},
        "spread": spread and group.get(spread.name, **where),
        "over_floor": group.over_floor(metric.name, **where) if is_value else None,
        DIGITS: digits,
    }


def _head(group: scores.ScoredGroup) -> Row:
    about = {"layers": str(group.layers or "all")}
    if group.medium is None:  # all insertions together
        about = {"medium": "all", "layers": ""}
    return {**vars(group), **about, "unflagged_edp": group.get("edp_percent", "unflagged")}


def lay_out_matrix(runs: Sequence[Run]) -> TableLayout:
    """Return one row per study: its verdict, and the tip errors that this states."""
    rows, stated = list[Row](), ("insertions", "te_mm", "baseline_te_mm", "paper_te_mm")
    for run in runs:
        verdict = run.first_page.verdict
        media = FitFrames.of(run).select_errors(role="validate")["medium"].unique()
        rows.append(
            {
                "study": scores.study_label(run),
                "medium": media[0] if len(media) == 1 else "several",
                **{name: verdict.numbers.get(name) for name in stated},
                "noise_of_te": verdict.numbers.get("floor_te_mm"),
                "verdict": verdict.word or "not scored",
            }
        )
    columns = ("study", "medium", *stated[:2], "noise_of_te", *stated[2:], "verdict")
    return _lay_out(Table("matrix", rows, columns), drop_empty=True, max_ratio=MAX_NOISE_RATIO)


#: recipe of the same fit whose specimens are of one batch, by recipe
BATCH_RECIPES = {"default": "one_batch"}


def lay_out_coverage(run: Run) -> TableLayout:
    """Return one row per medium, number of layers and specimen, over all folds."""
    frames, keys = FitFrames.of(run), ["medium", "layers", "specimen_treatment"]
    predicted = frames.predictive
    rows = [
        {
            **{"medium": medium, "layers": layers, "specimen_treatment": SPECIMEN_NAMES[str(treatment)]},
            **tabulate_coverage(group),
        }
        for (medium, layers, treatment), group in predicted.groupby(keys, sort=False)
    ]
    other = select_rows(predicted, specimen_treatment="others")
    spread = Row()
    if len(other):  # one standard deviation between specimens, as factors, and of how many it is known
        spread = {name: math.exp(other[f"between_sd_ln_{name}"].mean()) for name in ("mu", "b")}
        spread["specimens"] = int(other["other_specimens"].min())
        spread["batch_recipe"] = BATCH_RECIPES.get(run.record.recipe, "")
    sources = [str(source) for source in pd.unique(predicted["draw_source"])]
    columns = (column for column in COVERAGE_COLUMNS if frames.curved or not column.startswith("shape_"))
    table = Table("coverage", rows, (*keys, *columns))
    read = frames.curvature["kappa_in_95"].astype(float)
    return _lay_out(table, sources=sources, spread=spread, readings=read, curved=frames.curved)


def lay_out_baselines(run: Run) -> TableLayout:
    """Return every method's errors and its paired difference from ours on the same insertions."""
    frames, compared = FitFrames.of(run), scores.compare_methods(run)
    digits = 3 if (frames.errors["comparison"] == "aligned").any() else 2
    rows = [
        {
            **{**row, DIGITS: digits, "method": method_name(row["method"], run.origin)},
            **({} if number else {"difference_mm": None, "better": ""}),  # it is ours
        }
        for number, row in enumerate(to_records(compared))
    ]
    errors = [
        metric.name
        for metric in headline_metrics()
        if metric.name in compared and compared[metric.name].notna().any()
    ]
    columns = ("method", "insertions", *errors, *(("te_difference",) * (scores.TE in errors)), "better_of")
    return _lay_out(Table("baselines", rows, columns, strong="first"), role=frames.role)


def lay_out_insertions(run: Run) -> TableLayout:
    """Return our errors on single insertions: of held-out ones those of our predictions."""
    frames = FitFrames.of(run)
    chosen = frames.select_errors(method=frames.method)
    # a metric that was added since the run has no column
    candidates = [metric for metric in list_metrics() if not metric.spread_of and metric.name in chosen]
    metrics = [metric for metric in candidates if chosen[metric.name].notna().any()]
    columns = (
        *("insertion", "medium", "layers", "depth_mm", "deflection_mm", "predicted_deflection_mm"),
        *(metric.name for metric in metrics),
    )
    rows = [
        {
            **{**dict.fromkeys(columns), **row, "origin": run.origin},
            DIGITS: 3 if row["comparison"] == "aligned" else 2,
            "insertion": str(row["insertion"]) + ("" if row["converged"] else " (did not converge)"),
            **{
                metric.name: f"{format_metric(metric, row.get(metric.name))}†"
                for metric in list_metrics()
                if metric.relative and row["edp_flagged"]
            },
        }
        for row in to_records(chosen)
    ]
    return _lay_out(Table("insertions", rows, columns), method=frames.method)


# ---- parameters: posterior and error-minimising fit, beside the paper's

AT_BOUND = "*"  #: mark at the end of a range that is a bound
END_DIGITS = 2  #: significant digits of the ends of an interval


def _describe_parameter(name: str, rows: pd.DataFrame) -> Row:
    """Return the cells of one parameter from its rows of every method, of several folds their range.

    The posterior's value stands with its 95 % interval, that of the least errors with its range.
    """
    methods = group_values((row.method, row) for row in ParameterRow.read(rows))
    ours, errors, paper = (methods.get(method, []) for method in ("fitted", "fitted_metric", "hand_tuned"))
    statuses = {row.status for row in ours}
    fixed = not statuses & {"free", "tied"}  # in no fold it was searched
    label, unit, estimate = FittedParameter(name, ours).describe()
    if statuses == {"fixed"}:
        estimate = f"{estimate}, fixed"
    elif "prior" in statuses:
        shifts = (row.tip_shift_mm for row in ours if is_known(row.tip_shift_mm))
        estimate = f"{estimate}, {describe_prior(max(shifts, default=None))}"
    return {
        "parameter": label,
        "mode": _join_range([row.value for row in ours if is_known(row.median)], unit),
        "posterior": estimate,
        "error_minimising": "" if fixed else _format_least_errors(name, errors, unit),
        "hand_tuned": _join_range([row.value for row in paper], unit),
    }


@dataclass(frozen=True)
class FittedParameter:
    """What every fold has of a fitted parameter."""

    name: str
    rows: Sequence[ParameterRow]

    @property
    def symbol(self) -> str:
        return format_bare_symbol(self.name)

    @property
    def has_intervals(self) -> bool:
        """Whether every fold has an interval."""
        return bool(self.rows) and all(is_known(end) for row in self.rows for end in row.interval)

    @property
    def ends(self) -> list[tuple[float, bool]]:
        """The outermost ends of its intervals, each with whether it is a bound."""
        return _find_outermost(self.rows, [row.interval for row in self.rows])

    @property
    def is_at_bound(self) -> bool:
        return any(at_bound for _, at_bound in self.ends)

    @property
    def factor(self) -> float:
        """The factor between its outermost ends; NaN if one is not known."""
        (low, _), (high, _) = self.ends
        return high / low if self.has_intervals else math.nan

    def describe(self) -> tuple[str, float, str]:
        """Return the symbol with its unit, this unit in Pa, and "0.196 (0.12 to 0.28)".

        The estimate is the median of the draws, without any the fit's value.
        """
        ends = [end for row in self.rows for end in row.interval]
        some = ends if any(map(is_known, ends)) else [self.rows[0].value]
        label, unit = choose_printed_unit(self.name, some)
        medians = [row.median if is_known(row.median) else row.value for row in self.rows]
        estimate = _join_range(medians, unit)
        if self.has_intervals:
            texts = (f"{_format_end(end, unit)}{AT_BOUND if at_bound else ''}" for end, at_bound in self.ends)
            estimate += f" ({' to '.join(texts)})"
        return label, unit, estimate

    def describe_limit(self, bevel: str) -> str:
        """Return to what factor it is known, and what limits it, in the fold that knows it least."""
        if not self.has_intervals:
            return "interval not known"
        if self.is_at_bound:
            return "not determined: a bound limits it"
        limit, word = "its interval", find_least_determined(row.determined for row in self.rows)
        if is_logarithmic(self.name):
            limit = f"to a factor of {_format_end(self.factor)}"
        conditions = {
            row.condition.removeprefix("determined ") for row in self.rows if row.determined == word
        }
        limits = sorted(filter(None, conditions))
        if word == "only together" and not limits:
            limits.append(f"better as a product with {'others' if bevel in ('', self.symbol) else bevel}")
        return ", ".join((limit, *limits[:1]))


def list_fitted(parameters: pd.DataFrame) -> list[FittedParameter]:
    """Return every parameter that was fitted; those of a spread are left out."""
    rows = ParameterRow.read(select_rows(parameters, method="fitted"))
    searched = [
        row for row in rows if row.status in ("free", "tied") and row.parameter not in HYPERPARAMETERS
    ]
    grouped = group_values((row.parameter, row) for row in searched)
    return [FittedParameter(name, some) for name, some in grouped.items()]


def list_undetermined(run: Run) -> list[str]:
    """Return the symbols of moduli and lengths of which an interval reaches a bound, or is that of the prior.

    Shape parameters are left out: shapes hardly depend on them.
    """
    return [
        fitted.symbol
        for fitted in list_fitted(run.frames["parameters"])
        if is_logarithmic(fitted.name)
        and (fitted.is_at_bound or any(row.condition == FROM_PRIOR for row in fitted.rows))
    ]


def list_wide(run: Run) -> list[str]:
    """Return the symbols of the fitted parameters that are not known to a factor of 2 in every fold."""
    return [
        fitted.symbol
        for fitted in list_fitted(run.frames["parameters"])
        if find_least_determined(row.determined for row in fitted.rows) != "yes"
    ]


#: smallest ratio of a parameter's factor without a stated direction to the one with it, at which both are
#: named
MIN_GAIN = 2.0
MAX_GAINED_FACTOR = 100.0  #: largest factor with a stated direction that is named: a larger one is of no use


def list_gains_of_direction(run: Run) -> list[tuple[str, str, str]]:
    """Return symbol, factor now, and the factor by stated directions, of parameters known far better by them.

    They are those of shapes of unknown pose, to whose directions of insertion a fit would know them.
    """
    factors = run.knows(FitMetadata).with_direction
    fitted = {parameter.name: parameter for parameter in list_fitted(run.frames["parameters"])}
    return [
        (fitted[name].symbol, _format_end(fitted[name].factor), _format_end(factor))
        for name, factor in factors.items()
        if fitted[name].factor > MIN_GAIN * factor and factor <= MAX_GAINED_FACTOR
    ]


def describe_largest_factor(run: Run) -> str:
    """Return the largest factor between the ends of intervals of moduli and lengths; empty if unknown."""
    fitted = list_fitted(run.frames["parameters"])
    factors = [some.factor for some in fitted if is_logarithmic(some.name) and some.has_intervals]
    return _format_end(max(factors)) if factors else ""


def lay_out_estimates(run: Run, rigidity: Mapping[str, RigidityMetadata] | None = None) -> TableLayout:
    """Return every parameter that was fitted with its 95 % interval and what limits it, where it was judged.

    Below stand the priors that the medium states of them. Moduli are in proportion to `rigidity`.
    """
    parameters, medium = run.frames["parameters"], run.knows(JobMetadata).medium
    fitted = list_fitted(parameters)
    bevel = next((parameter.symbol for parameter in fitted if parameter.name in BEVEL_PARAMETERS), "")
    rows = list[Row]()
    for parameter in fitted:
        label, _, estimate = parameter.describe()
        limit = parameter.describe_limit(bevel)
        rows.append({"parameter": label, "posterior": estimate, "limited_by": limit})
    notes = [TEXT.sentence("rigidity", {"rigidity": rigidity})] if rigidity else []
    stated = {name: record.prior for name, record in medium.parameters.items() if record.prior is not None}
    if priors := {parameter.name: stated[parameter.name] for parameter in fitted if parameter.name in stated}:
        notes.append(TEXT.sentence("priors", {"priors": priors}))
    notes += [f"{AT_BOUND}: a bound."] if any(AT_BOUND in row["posterior"] for row in rows) else []
    is_judged = bool((parameters["determined"] != "").any())
    columns = ("parameter", "posterior", *(("limited_by",) * is_judged))
    return Table("estimates", rows, columns, notes=tuple(notes)).lay_out()


def _join_range(values: Sequence[float], unit: float) -> str:
    """Return "0.196", or "0.19 to 0.21" for several values."""
    scaled = [value / unit for value in values if is_known(value)]
    ends = (min(scaled), max(scaled)) if scaled else ()
    return " to ".join(dict.fromkeys(map(format_plain, ends)))


def _format_least_errors(name: str, rows: Sequence[ParameterRow], unit: float) -> str:
    """Return "0.19 (0.12 to bound)": the value of the least errors, and the range within the tolerance.

    A value that is not known lies at a bound: errors do not determine it.
    """
    if not all(is_known(row.value) for row in rows):
        return "not determined by errors alone"
    values = [row.value for row in rows]
    ends = (min(values), max(values)) if values else ()
    value = " to ".join(dict.fromkeys(_format_near(name, end, unit, 3) for end in ends))
    bounded = [row for row in rows if is_known(row.low) and is_known(row.high)]
    if not bounded:
        return value
    outermost = _find_outermost(bounded, [(row.low, row.high) for row in bounded])
    words = ("bound" if at_bound else _format_near(name, end, unit) for end, at_bound in outermost)
    return f"{value} ({' to '.join(words)})"


def _format_near(name: str, value: float, unit: float, digits: int = END_DIGITS) -> str:
    """Return a value in the unit of its row; with its own unit where people read it in another one."""
    scale, own_unit = choose_unit(name, value)
    near = scale == unit or not name.endswith("_pa")
    text = _format_end(value, unit if near else scale, digits)
    return text if near else f"{text} {own_unit}"


def _find_outermost(
    rows: Sequence[ParameterRow], ranges: Sequence[tuple[float, float]]
) -> list[tuple[float, bool]]:
    """Return the least low end and the greatest high end of ranges, each with whether it is a bound."""
    (low, high), bounds = zip(*ranges, strict=True), [(row.bound_low, row.bound_high) for row in rows]
    return [
        (end, any(math.isclose(end, bound[side], rel_tol=1e-6) for bound in bounds))
        for side, end in enumerate((min(low), max(high)))
    ]


def _format_end(end: float, unit: float = 1.0, digits: int = END_DIGITS) -> str:
    return format_plain(round_significant(end / unit, digits))


#: words for what the intervals of parameters are from, by `draw_source`, but for a sampled posterior
SOURCES = {"importance": "importance sampling", "profile": "profile likelihood"}


def lay_out_parameters(run: Run) -> TableLayout:
    """Return posterior and error-minimising fit beside the paper's parameters, of several folds their range.

    Parameters with the same cells have one row.
    """
    frames, stated = FitFrames.of(run), run.knows(FitMetadata)
    sampler, used = {"posterior": stated.recipe.sample.sampler}, {*frames.parameters["draw_source"]}
    merged: dict[tuple[object, ...], Row] = {}
    for name, members in frames.parameters.groupby("parameter", sort=False):
        if "fitted" not in set(members["method"]):
            continue
        row = _describe_parameter(str(name), members)
        label = row.pop("parameter")
        merged.setdefault(tuple(row.values()), {**row, "names": []})["names"].append(label)
    rows = [{**row, "parameter": ", ".join(row["names"])} for row in merged.values()]
    columns = ("parameter", "mode", "posterior", "error_minimising", "hand_tuned")
    values = {
        "folds": int(frames.parameters["fold"].nunique()),
        "modes": any(row["mode"] for row in rows),
        "bounds": any(AT_BOUND in row["posterior"] for row in rows),
        "together": find_known_combination(run),
        "population": list_spreads(run),
        "printed": any(row["hand_tuned"] for row in rows),
        "metric": any(row["error_minimising"] for row in rows),
        "curved": frames.curved,
        "sources": [words for source, words in (sampler | SOURCES).items() if source in used],
        "of_mean": bool(set(frames.draws["specimen"]) - {TUNED_SPECIMENS, NEW_SPECIMEN}),
        "leaning": [
            stated_depth
            for stated_depth in stated.stated_depths
            if stated_depth.sd_mm > stated_depth.stated_sd_mm
        ],
    }
    return _lay_out(Table("parameters", rows, columns), drop_empty=True, **values)


def list_spreads(run: Run) -> list[tuple[str, float, int]]:
    """Return the factor between specimens that is one SD, by parameter, and the number of specimens."""
    rows = to_records(FitFrames.of(run).population.drop_duplicates("parameter"))
    return [(row["parameter"], math.exp(row["between_sd"]), int(row["other_specimens"])) for row in rows]


def find_known_combination(run: Run) -> str:
    """Return the best known combination of several parameters, with its precision.

    "" if none is known, or if every parameter is determined by itself.
    """
    frames = FitFrames.of(run)
    free = frames.free_parameters
    if (free["determined"][~free["parameter"].isin(HYPERPARAMETERS)] == "yes").all():
        return ""
    rows = to_records(frames.directions)
    determined = (row for row in rows if row["sd"] < MAX_LOG_SD and row["sd_ratio"] < UNINFORMED_SD_RATIO)
    return next((str(row["note"]) for row in determined if row["parameters"] > 1), "")


#: columns of the convergence of a sampled posterior
CHAIN_COLUMNS = ("r_hat", "ess", "autocorrelation_time", "acceptance")


def tabulate_percentiles(run: Run) -> pd.DataFrame:
    """Return one row per fold and free parameter: percentiles (Pa, mm), and how the chains converged.

    `acceptance` is the fold's. `converged` is false where the criteria, which concern more than the
    parameters, are not met: percentiles are then not final.
    """
    names = [f"p{percentile:g}" for percentile in PERCENTILES]
    columns, rows = ("fold", "parameter", *names, *CHAIN_COLUMNS, "converged", "origin"), []
    for fold, posterior in run.posteriors.items():
        # the last one is of the density
        chains = zip(posterior.r_hat, posterior.ess, posterior.autocorrelation_time, strict=False)
        of_run = np.mean(posterior.acceptance_fraction), not posterior.faults, run.origin
        percentiles = posterior.percentiles().items()
        rows += [
            (fold, name, *values, *chain, *of_run)
            for (name, values), chain in zip(percentiles, chains, strict=False)
        ]
    return pd.DataFrame(rows, columns=columns)


def lay_out_chains(run: Run) -> TableLayout:
    """Return one row per fold and parameter that was sampled: how its walkers converged.

    Parameters that are held have no chain: their draws are of the prior.
    """
    parameters = FitFrames.of(run).parameters
    held = set(parameters.loc[parameters["status"] == "prior", "parameter"])
    rows = [
        {**row, "parameter": format_bare_symbol(row["parameter"])}
        for row in to_records(tabulate_percentiles(run))
        if row["parameter"] not in held
    ]
    return _lay_out(Table("chains", rows, ("fold", "parameter", *CHAIN_COLUMNS), groups=("fold",), heads=1))
