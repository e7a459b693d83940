"""Run the studies on many synthetic datasets, compare the fit with every other method, and explain losses.

This is the consistency of the synthetic data, not evidence for the model. Every seed draws needle, specimens,
noise and registration anew; the plan of insertions stays. A pair is one insertion of one dataset; its
difference is the error of the fit less that of the other method. Insertions of one dataset share its
specimens, needle and fit, so that they are not independent: datasets are drawn with replacement, and of each
the insertions (a cluster bootstrap; `scipy.stats.bootstrap` knows one level only). The interval is the middle
95 % of the means so drawn. An explanation of a loss is given only with the numbers that support it, computed
from the same runs:

- *the truth* knows needle, moduli, friction and bevel, of which a fit knows nothing;
- *another medium*: the method errs more than the fit on the insertions that were tuned on, and less on a
  medium in which needles bend less than the fit predicts. It predicts less bending everywhere;
- *its moduli*: those of the method are not fitted, and nearer to the true ones than the fitted ones;
- *too small to matter*: the difference is under a tenth of the noise floor.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np
import pandas as pd
from pydantic import Field

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion
from needlefit.datasets.read import read
from needlefit.inference.compared_points import Curve, SimulatedCurve
from needlefit.mechanics.control import Bevel, ModelOptions
from needlefit.mechanics.simulate import simulate
from needlefit.mechanics.tissue import Tissue
from needlefit.metrics import METRICS, Metric, list_metrics
from needlefit.project.random_streams import random_stream
from needlefit.project.toml import add_study_context
from needlefit.reporting.figures import Drawing, Look
from needlefit.reporting.labels import GREY, INK, METHOD_COLOURS, PAPER_COLOUR, medium_name, method_name
from needlefit.reporting.number_format import MISSING, choose_printed_unit, format_metric
from needlefit.reporting.table import Table, part, pivot
from needlefit.reporting.table_files import Row, to_records
from needlefit.reporting.text import KindText
from needlefit.schemas.analyses import AnalysisRecord
from needlefit.schemas.limits import MAX_REPLICATES, MAX_RESAMPLES, MAX_STARTS
from needlefit.studies import paper, paper_cells, score
from needlefit.studies.fit_frames import list_length_metrics, list_methods, list_score_columns
from needlefit.studies.job import Settings
from needlefit.studies.kind import StudyKind
from needlefit.studies.report import StudyReport
from needlefit.studies.run import Frames, Run, Status
from needlefit.studies.runner import AnalysisPlan, FrameRows, list_faults, run_analysis
from needlefit.studies.simulated_data import find_true_value
from needlefit.synthetic.build import build_unscanned
from needlefit.synthetic.design import PlannedInsertion, bevel_offset, draw_needle, list_planned_insertions
from needlefit.synthetic.insertion import SyntheticInsertion, simulate_insertion


class SeedsRecord(AnalysisRecord):
    """`kind = "seeds"`: studies repeated on synthetic datasets of many seeds."""

    kind: Literal["seeds"]
    studies: tuple[str, ...] = Field(min_length=1)
    """Studies that are repeated."""
    fits: tuple[str, ...] = ()
    """Fits that are repeated."""
    generalization_studies: tuple[str, ...] = ()
    """Studies that, in the paper, generalise to their held-out insertions."""
    seeds: int = Field(default=20, ge=2, le=MAX_REPLICATES)
    """Number of synthetic datasets."""
    first_seed: int = Field(default=1, ge=0)
    """Seed of the first dataset; the others follow."""
    starts: int | None = Field(default=None, ge=1, le=MAX_STARTS)
    """Random starting points, in place of the recipe's."""
    resamples: int = Field(default=2000, ge=100, le=MAX_RESAMPLES)
    """Bootstrap resamples of the intervals."""


KIND = StudyKind("seeds", SeedsRecord, __name__)

TRUTH = "truth"  #: the method that knows the needle as it really is

GROUP_KEYS = ["study", "medium", "layers"]
COMPARISON_COLUMNS = (
    *(*GROUP_KEYS, "method", "metric", "replicates", "insertions"),
    *("value", "baseline_value", "difference", "low", "high", "floor"),
    *("share", "replicates_better", "verdict"),
)
"""`difference` < 0: the fit errs less. `share`, `replicates_better`: parts of the pairs, and number of
datasets by their means, on which it does; `verdict` is "wins", "loses", or "open" where the interval
holds 0."""

NEGLIGIBLE_FLOOR_FRACTION = 0.1
"""Part of the noise floor under which a difference of means matters to nobody."""

UNEXPLAINED = "not explained"


def run(name: str, record: SeedsRecord, settings: Settings) -> Run:
    """Run all studies and fits on every synthetic dataset."""
    with add_study_context(name, "studies, fits"):
        shipped = paper_cells.prepare_jobs(record.studies, record.fits, settings)
        fits = paper_cells.load_fits(record.studies, record.fits)
    jobs = {study: paper_cells.with_starts(job, record.starts) for study, job in shipped.items()}
    asked = {one.id for job in jobs.values() for one in job.insertions}
    plan = [planned for planned in list_planned_insertions() if planned.id in asked]
    seeds = range(record.first_seed, record.first_seed + record.seeds)
    tasks = {f"seed {seed}": partial(_run_on_twin, seed, record, fits, plan, settings) for seed in seeds}
    columns = {
        "errors": ("seed", *paper_cells.ERROR_COLUMNS, *list_score_columns()),
        "parameters": ("seed", "study", "parameter", "value", "truth", "paper"),
    }
    conclude = partial(_conclude, name, record, paper_cells.find_paper_numbers(jobs))
    also = {"seeds": list(seeds), "twins": "not scanned"}
    work = AnalysisPlan(list(jobs.values()), tasks, columns, conclude, also)
    return run_analysis(name, record, settings, work)


def _run_on_twin(
    seed: int,
    record: SeedsRecord,
    fits: Mapping[str, paper_cells.LoadedFit],
    plan: Sequence[PlannedInsertion],
    settings: Settings,
) -> FrameRows:
    """Return the errors of all methods on one dataset of the insertions `plan`, and the fitted parameters.

    Their `truth` is the geometric mean over what a fit learns from. It may run on a machine without the files
    of `fits`.
    """
    with TemporaryDirectory() as folder:
        dataset = read(build_unscanned(Path(folder), seed, plan))
    jobs = paper_cells.prepare_on_dataset(fits, settings, dataset)
    floors, truth = paper_cells.compute_floors(jobs.values()), _true_predictor(seed)
    errors, parameters = list[Row](), list[Row]()
    for job in (paper_cells.with_starts(job, record.starts) for job in jobs.values()):
        searches = [search for search in job.searches if search != "fitted_metric"]
        found = {search: paper_cells.run_search(job, search, settings) for search in searches}
        problem = job.problem(job.folds[0])
        predictors = {**score.make_predictors(problem, found, job.hand_tuned), TRUTH: truth}
        errors += paper_cells.score_methods(job, predictors, floors)
        values, printed = found["fitted"].values, job.hand_tuned or {}
        parameters += [
            {"study": job.name, "parameter": name, "value": values[name]}
            | {"truth": find_true_value(problem, name, seed), "paper": printed.get(name, float("nan"))}
            for name in job.parameters.free
        ]
    frames = {"errors": errors, "parameters": parameters}
    return {frame: [{"seed": seed, **row} for row in rows] for frame, rows in frames.items()}


def _true_predictor(seed: int) -> score.Predictor:
    """Return the method that simulates the true needle, moduli, friction and bevel of a dataset.

    It is given what the fit is given besides: the stated pose, the measured depth and crossings. What it
    still errs by is what the measurement does.
    """
    planned = {one.id: one for one in list_planned_insertions()}
    twins: dict[str, SyntheticInsertion] = {}

    def curve(insertion: Insertion) -> Curve:
        if insertion.id not in twins:
            twins[insertion.id] = simulate_insertion(planned[insertion.id], seed)
        twin = twins[insertion.id]
        tissue = twin.true_insertion.tissue
        if twin.specimen.field is None:  # the layers that it was measured to meet
            layers = np.array(insertion.sequence) - 1
            mu, alpha = twin.specimen.mu[layers], twin.specimen.alpha[layers]
            gamma = np.array([twin.specimen.friction])
            tissue = Tissue(mu, alpha, insertion.boundaries, friction=gamma)
        bevel = Bevel(bevel_offset(twin.specimen, twin.planned, twin.deviations), insertion.side)
        return SimulatedCurve(
            simulate(draw_needle(seed), tissue, bevel, insertion.depth, rules=ModelOptions())
        )

    return score.curve_predictor(curve)


def _conclude(name: str, record: SeedsRecord, numbers: dict[str, int], frames: Frames) -> tuple[str, ...]:
    errors = frames["errors"]
    fitted = errors[errors["method"] == "fitted"]
    frames["cells"] = _summarize_seeds(paper_cells.tabulate_cells(fitted, numbers, ("seed",)))
    frames["parameter_cells"] = _summarize_parameters(frames["parameters"])
    pattern = paper_cells.tabulate_generalisation(fitted, ("seed",))
    in_paper = pattern["study"].isin(record.generalization_studies)
    frames["pattern"] = pattern.assign(generalises_in_paper=in_paper)
    compared = compare_methods(errors, name, record.resamples)
    frames["comparisons"] = explain_losses(compared, errors, frames["parameters"])
    failed = int((~errors["converged"].astype(bool)).sum())
    return list_faults({"simulations did not converge": failed})


def _quantiles(grouped: Any, prefix: str = "") -> dict[str, "pd.Series[float]"]:  # noqa: ANN401 - of pandas
    return {f"{prefix}q{q:02d}": grouped.quantile(q / 100) for q in (5, 50, 95)}


def _summarize_seeds(every: pd.DataFrame) -> pd.DataFrame:
    """Return mean and quantiles over seeds of every cell, and on how many seeds it is below the paper's."""
    every = every.assign(below=every["value"] < every["paper"])
    grouped = every.groupby([*paper_cells.CELL_KEYS, "metric", "unit"], sort=False)
    columns = {
        "insertions": grouped["insertions"].first(),
        "replicates": grouped["value"].size(),
        "mean": grouped["value"].mean(),
        **_quantiles(grouped["value"]),
        "floor": grouped["floor"].mean(),
        "paper": grouped["paper"].first(),
        "seeds_below_paper": grouped["below"].sum(),
    }
    return pd.DataFrame(columns).reset_index()


def _summarize_parameters(values: pd.DataFrame) -> pd.DataFrame:
    """Return quantiles over seeds of every fitted parameter, and of its ratio to the true one."""
    values = values.assign(ratio=values["value"] / values["truth"])
    grouped = values.groupby(["study", "parameter"], sort=False)
    columns = {
        "replicates": grouped.size(),
        **_quantiles(grouped["value"]),
        "paper": grouped["paper"].first(),
        **_quantiles(grouped["ratio"], "ratio_to_true_"),
    }
    return pd.DataFrame(columns).reset_index()


# ---- comparisons of the fit with other methods, and reasons for losses


def compare_methods(errors: pd.DataFrame, name: str, resamples: int) -> pd.DataFrame:
    """Return every comparison of the fit with another method on held-out insertions."""
    rows = []
    for key, group in errors[errors["role"] == "validate"].groupby(GROUP_KEYS, sort=False):
        head = dict(zip(GROUP_KEYS, key, strict=True))
        for metric in [one.name for one in list_length_metrics()]:
            wide = group.pivot_table(index="seed", columns=["method", "insertion"], values=metric, sort=False)
            wide = wide.replace([np.inf], np.nan)  # not solved
            floor = float(group.groupby("insertion")[f"floor_{metric}"].mean().mean())
            fitted = wide["fitted"].to_numpy(dtype=np.float64)  # (S, n) of n insertions of S datasets, mm
            for method in [one for one in group["method"].unique() if one != "fitted"]:
                rng = random_stream(0, name, *map(str, key), method, metric)
                other = wide[method].to_numpy(dtype=np.float64)
                difference = fitted - other
                low, high = bootstrap_interval(difference, resamples, rng)
                row = {
                    "replicates": len(difference),
                    "insertions": difference.shape[1],
                    "value": float(np.nanmean(fitted)),
                    "baseline_value": float(np.nanmean(other)),
                    "difference": float(np.nanmean(difference)),
                    "low": low,
                    "high": high,
                    "share": float(np.mean(difference[np.isfinite(difference)] < 0)),
                    "replicates_better": int((np.nanmean(difference, axis=1) < 0).sum()),
                    "verdict": "wins" if high < 0 else "loses" if low > 0 else "open",
                }
                rows.append({**head, "method": method, "metric": metric, "floor": floor, **row})
    return pd.DataFrame(rows, columns=list(COMPARISON_COLUMNS))


def bootstrap_interval(values: Floats, resamples: int, rng: np.random.Generator) -> tuple[float, float]:
    """Return the 95 % interval of the mean of `values` (S, n), by the bootstrap over S clusters of n."""
    clusters, members = values.shape
    twin = rng.integers(0, clusters, size=(resamples, clusters, 1))
    insertion = rng.integers(0, members, size=(resamples, clusters, members))
    means = np.nanmean(values[twin, insertion], axis=(1, 2))
    low, high = np.percentile(means, [2.5, 97.5])
    return float(low), float(high)


def explain_losses(comparisons: pd.DataFrame, errors: pd.DataFrame, parameters: pd.DataFrame) -> pd.DataFrame:
    """Return the comparisons with a `note` where the fit loses; it is empty elsewhere."""
    notes = []
    for row in comparisons.to_dict("records"):
        reasons = _find_reasons(row, errors, parameters) if row["verdict"] == "loses" else iter([""])  # type: ignore[arg-type]
        notes.append(next(reasons, UNEXPLAINED))
    return comparisons.assign(note=notes)


def _find_reasons(row: Row, errors: pd.DataFrame, parameters: pd.DataFrame) -> Iterator[str]:
    """Yield the reasons for a loss that the data support, the first of which is given."""
    method = row["method"]
    if method == TRUTH:
        yield "it is the needle as it really is: its own moduli, rigidity, friction and bevel"
    mine = errors[errors["study"] == row["study"]]
    tuned, held_out = (mine[mine["role"] == role] for role in ("tune", "validate"))
    if row["medium"] not in set(tuned["medium"]):
        ours, theirs = (_mean_error(tuned, one, row["metric"]) for one in ("fitted", method))
        fit, other = (_mean_error(held_out, one, "predicted_deflection_mm") for one in ("fitted", method))
        true = _mean_error(held_out, "fitted", "deflection_mm")
        if theirs > ours and fit > max(true, other):
            yield (
                f"another medium, which bends by {true:.2f} mm: the fit predicts {fit:.2f}, the method "
                f"{other:.2f}; its error on the fitted insertions is larger than that of the fit "
                f"({theirs:.2f} against {ours:.2f} mm)"
            )
    if method == "hand_tuned_b":
        own = (parameters["study"] == row["study"]) & parameters["parameter"].str.startswith("mu")
        mu = parameters[own]
        ours, theirs = (float(np.exp(np.abs(np.log(mu[c] / mu["truth"])).mean())) for c in ("value", "paper"))
        if theirs < ours:
            yield (
                "its moduli are not fitted, and nearer to the true ones than the fitted ones (off by a "
                f"factor of {theirs:.2f} against {ours:.2f}): only b is fitted"
            )
    if row["difference"] < NEGLIGIBLE_FLOOR_FRACTION * row["floor"]:
        yield f"under a tenth of the noise floor of {row['floor']:.2f} mm"


def _mean_error(errors: pd.DataFrame, method: str, metric: str) -> float:
    values = errors.loc[errors["method"] == method, metric].astype(float)
    return float(values.replace([np.inf], np.nan).mean())


# ---- the report


def describe(result: Run) -> dict[str, Any]:
    """Return what the text prints."""
    pattern, compared = result.frames["pattern"], result.frames["comparisons"]
    agrees = (pattern["generalises"] == pattern["generalises_in_paper"]).groupby(pattern["seed"]).all()
    losses = compared[compared["verdict"] == "loses"]
    return {
        "generalizing": [study_name(name).lower() for name in result.record.generalization_studies],
        "agrees": int(agrees.sum()),
        "datasets": len(agrees),
        "limit_mm": float(pattern["limit_mm"].iloc[0]),
        "studies": [
            {"name": study_name(str(name)), "seeds": len(rows), "generalises": int(rows["generalises"].sum())}
            | {"ipe": rows["ipe_mean_mm"].quantile([0.05, 0.5, 0.95]).tolist()}
            | {"floor": rows["floor_ipe_mean_mm"].mean(), "paper": bool(rows["generalises_in_paper"].all())}
            for name, rows in pattern.groupby("study", sort=False)
        ],
        "methods": [
            {"name": method_name(str(method))}
            | {one: int((rows["verdict"] == one).sum()) for one in ("wins", "loses", "open")}
            for method, rows in compared.groupby("method", sort=False)
        ],
        "losses": len(losses),
        "unexplained": int((losses["note"] == UNEXPLAINED).sum()),
        "replicates": int(result.frames["cells"]["replicates"].max()),
    }


def rate(result: Run) -> Status:
    """Return "warn" if the paper's pattern fails on some dataset."""
    frame = result.frames["pattern"]
    return "pass" if (frame["generalises"] == frame["generalises_in_paper"]).all() else "warn"


def study_name(name: str) -> str:
    """Return the printed name of a study or fit."""
    return medium_name(name).capitalize()


_GROUP = ("study", "medium", "layers")
_GROUPINGS = ("validation", "tuning_by_layers", "tuning_by_media")


def tabulate(result: Run) -> list[Table]:
    """Return tables of every cell over the datasets, the parameters, the comparisons, and the losses."""
    tables = []
    metrics = (part("twin_statistic", metric=one.name) for one in list_metrics())
    columns: tuple[Any, ...] = (*_GROUP, "insertions", "row", *metrics)
    for grouping in _GROUPINGS:
        cells = result.frames["cells"]
        rows = [
            {**row, "row": name, "twin_statistic": write(row, METRICS[row["metric"]])}
            for row in _name_rows(cells[cells["grouping"] == grouping])
            for name, write in _ROW_FORMATS.items()
        ]
        whole = pivot(rows, [*_GROUP, "row"], ["metric"])
        tables.append(Table(grouping, whole, columns, groups=_GROUP, heads=4, strong="groups"))
    quantiles = ("q50", "q05", "q95")
    columns = ("study", "parameter", *quantiles, "paper", *(f"ratio_to_true_{key}" for key in quantiles))
    rows = []
    for row in _name_rows(result.frames["parameter_cells"]):
        label, unit = choose_printed_unit(str(row["parameter"]), [row["q95"]])
        scaled = {name: None if row[name] is None else row[name] / unit for name in (*quantiles, "paper")}
        rows.append({**row, **scaled, "parameter": label})
    tables.append(Table("parameter_cells", rows, columns, groups=("study",), heads=1))
    frame = result.frames["comparisons"]
    order = frame["method"].map([*list_methods(), TRUTH].index)
    groups = frame.assign(order=order).groupby(list(_GROUP), sort=False)
    ordered = pd.concat([group.sort_values("order", kind="stable") for _, group in groups])
    first = ordered["metric"].iloc[0]  # the metrics of a method stay together
    rows = [
        {**row, "method": method_name(row["method"]) if row["metric"] == first else ""}
        for row in _name_rows(ordered)
    ]
    columns = (
        *(*_GROUP, "method", "metric", "fit_error", "method_error", "fit_less_method", "difference_range"),
        *("twins_better", "verdict"),
    )
    tables.append(Table("comparisons", rows, columns, groups=_GROUP, heads=3))
    # losses: without a reason first; against the truth, where they are expected, last
    losses = frame.query("verdict == 'loses'")
    losses = losses.assign(last=losses["method"] == TRUTH, known=losses["note"] != UNEXPLAINED)
    rows = _name_rows(losses.sort_values(["last", "known"], kind="stable"))
    return [*tables, Table("losses", rows, (*_GROUP, "method", "metric", "fit_less_method", "note"))]


def _name_rows(frame: pd.DataFrame) -> list[Row]:
    return [
        {**row, "study": study_name(str(row["study"])), "layers": row.get("layers") or "all"}
        for row in to_records(frame)
    ]


_ROW_FORMATS: Mapping[str, Callable[[Row, Metric], str]] = {
    "median": lambda row, metric: format_metric(metric, row["q50"]),
    "5 to 95 %": lambda row, metric: " to ".join(format_metric(metric, row[q]) for q in ("q05", "q95")),
    "noise floor": lambda row, metric: format_metric(metric, row["floor"]),
    "paper": lambda row, metric: format_metric(metric, row["paper"]),
    "below paper": lambda row, metric: MISSING if row["paper"] is None else str(row["seeds_below_paper"]),
}


_OURS = METHOD_COLOURS["fitted"]
_PATTERN_LOOKS = {
    "twin generalises": Look("datasets (generalises in the paper)", _OURS, size=3, shift=0.12),
    "twin": Look("datasets (does not)", PAPER_COLOUR, size=3, shift=0.12),
    "median": Look("median", INK, "|", width=1.6),
    "paper": Look("the paper's groups", INK, "D", filled=False, size=4, shift=-0.12),
}
_CELL_LOOKS = {
    "twin": Look("datasets: median and 5 to 95 %", _OURS),
    "floor": Look("noise floor", INK, "|", dashes=(0, (2, 1.5)), width=0.8),
    "paper": Look("the paper", PAPER_COLOUR, "D", filled=False),
}


def draw(result: Run) -> dict[str, Drawing]:
    """Return the pattern, the comparisons of methods, and every cell."""
    compared = result.frames["comparisons"].assign(origin=result.origin)
    cells = result.frames["cells"].assign(origin=result.origin)
    first, *_ = [one.name for one in list_length_metrics()]
    outcomes = {"wins": ("the fit wins", _OURS), "loses": ("loses", PAPER_COLOUR), "open": ("open", GREY)}
    looks = {
        f"{verdict} {one.name}": Look(
            f"{label} ({one.label})",
            colour,
            filled=one.name == first,
            shift=-0.17 if one.name == first else 0.17,
        )
        for verdict, (label, colour) in outcomes.items()
        for one in list_length_metrics()
    }
    methods = [name for name in (*list_methods(), TRUTH) if name in set(compared["method"])]
    of_comparisons = {
        **{"rows": GROUP_KEYS, "value": "difference", "by": "look", "looks": looks, "panel": "method"},
        **{"panels": {name: method_name(name) for name in methods}, "columns": 3},
        **{"intervals": [("low", "high")], "name_row": _name_group, "scale": 0.1, "zero": True},
        "x_label": "error of the fit less that of the method (mm)",
    }
    of_cells = {
        **{"rows": ["grouping", *GROUP_KEYS], "value": "value", "by": "look", "looks": _CELL_LOOKS},
        **{"panel": "metric", "panels": {one.name: f"{one.label} ({one.unit})" for one in list_metrics()}},
        **{"intervals": [("q05", "q95")], "name_row": lambda row: _name_group(row[1:], row[0])},
        "scale": {one.name: "log" if one.unit == "%" else "from 0" for one in list_metrics()},
    }
    of_pattern = {
        **{"rows": ["study"], "value": "ipe_mean_mm", "by": "look", "looks": _PATTERN_LOOKS},
        **{"name_row": lambda row: study_name(row[0]), "row_height": 0.36, "scale": "from 0"},
        "x_label": "mean in-plane error of what is held out (mm); left of the line a study generalises",
        "line": float(result.frames["pattern"]["limit_mm"].iloc[0]),
    }

    def look_at_pattern(frame: pd.DataFrame) -> pd.DataFrame:
        generalises = (frame["mark"] == "twin") & (frame["generalises_in_paper"] == True)  # noqa: E712 - or missing
        return frame.assign(look=frame["mark"] + generalises.map({True: " generalises", False: ""}))

    def look_at_comparisons(frame: pd.DataFrame) -> pd.DataFrame:
        return frame.assign(look=frame["verdict"] + " " + frame["metric"])

    def look_at_cells(frame: pd.DataFrame) -> pd.DataFrame:
        values = {"twin": "q50", "floor": "floor", "paper": "paper"}
        parts = [frame.assign(look=look, value=frame[column]) for look, column in values.items()]
        bare = {"q05": np.nan, "q95": np.nan}
        return pd.concat([parts[0], *(one.assign(**bare) for one in parts[1:])], ignore_index=True)

    form = "dots_with_intervals"
    return {
        "generalising": Drawing(form, _tabulate_pattern(result), of_pattern, look_at_pattern),
        "comparisons": Drawing(form, compared, of_comparisons, look_at_comparisons),
        "cells": Drawing(form, cells, of_cells, look_at_cells),
    }


def _tabulate_pattern(result: Run) -> pd.DataFrame:
    """Return mean IPE of every study: on each dataset, their median, and of the paper's groups."""
    every = result.frames["pattern"]
    twins = every[["study", "seed", "ipe_mean_mm", "limit_mm", "generalises_in_paper"]]
    about = twins.groupby("study", sort=False).agg(
        {"ipe_mean_mm": "median", "limit_mm": "first", "generalises_in_paper": "all"}
    )
    table = paper.read_published_table("validation")
    printed = [
        {"mark": "paper", "study": name, "ipe_mean_mm": float(ipe)}
        for name in about.index
        for ipe in table.loc[table["study"].astype(str) == name.removeprefix("study"), "ipe_mean_mm"]
    ]
    parts = [twins.assign(mark="twin"), about.reset_index().assign(mark="median"), pd.DataFrame(printed)]
    columns = ["mark", *twins.columns]
    known = [part.reindex(columns=columns).astype({"seed": "Int64"}) for part in parts if len(part)]
    return pd.concat(known, ignore_index=True).assign(origin=result.origin)


def _name_group(group: tuple[Any, ...], grouping: str = "validation") -> str:
    study, medium, layers = group
    if grouping == "validation":
        return f"{medium_name(study)}: {medium_name(medium)}, {layers}"
    label = grouping.replace("tuning_by_", "tuned, by ")
    return f"{label}: {medium_name(medium)}" + (f", {layers}" if layers else "")


REPORT = StudyReport(KindText("seeds"), describe, tabulate, draw, rate=rate)
