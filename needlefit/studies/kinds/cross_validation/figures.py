"""The figures of fits and cross-validations: which form draws which frame."""

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd

from needlefit.arrays import Floats
from needlefit.datasets.select import group_independent
from needlefit.inference.baselines import list_baselines
from needlefit.inference.parameters import is_logarithmic
from needlefit.inference.proportions import estimate_proportion
from needlefit.reporting.figures import Drawing, Look
from needlefit.reporting.figures.fit_forms import (
    BANDS,
    DRAWN_SETS,
    HEIGHT_COLUMNS,
    INSERTION_KEYS,
    LAYER,
    PREDICTED_LEVELS,
    PREDICTED_QUANTITIES,
    QUARTILES,
    InsertionKey,
    corner,
    errors_by_group,
    insertions,
    predictive_check,
    residuals,
    waterfall,
)
from needlefit.reporting.labels import (
    INK,
    PAPER_COLOUR,
    layers_name,
    medium_name,
    method_colour,
    method_marker,
    method_name,
    study_name,
)
from needlefit.reporting.number_format import format_mm
from needlefit.reporting.table_files import Row, to_records
from needlefit.studies.kinds.cross_validation.facts import describe_counts
from needlefit.studies.kinds.cross_validation.posterior import find_ridge_ends, list_free_parameters
from needlefit.studies.rank_statistics import ecdf_band
from needlefit.studies.run import Run
from needlefit.studies.score import list_methods
from needlefit.studies.scored_groups import TE, ScoredGroup, list_held_out_groups, study_label
from needlefit.studies.summary import find_bevel_sides, tabulate_points

# ---- insertions

_POINT_COLUMNS = [*INSERTION_KEYS, "curve", "x_mm", *HEIGHT_COLUMNS]
MAX_LARGE_PANELS = 24
"""Insertions at most whose panels are large."""

_OVERLAY_POINT_STEP, _RESIDUAL_POINT_STEP = 5, 2  # of the points compared, one in so many is drawn


def collect_curves(results: Run, role: str, shown: Iterable[str], every: int = 1) -> pd.DataFrame:
    """Return one row per drawn point of a role's insertions; y is toward the bevel, mm.

    `curve` is a method of `shown`, "measured" (of the points, one in `every`), or the level of a band, which
    held-out insertions have: `low_mm`, `high_mm` are its ends.
    """
    where = "role == @role and boundaries == 'measured' and method in @shown"
    shapes = results.frames["shapes"].query(where, local_dict={"role": role, "shown": list(shown)})
    shapes = shapes.sort_values([*INSERTION_KEYS, "method", "j"])
    simulated = shapes.set_axis([c.replace("simulated_", "") for c in shapes.columns], axis=1)
    dots = shapes.drop_duplicates([*INSERTION_KEYS, "j"])
    bands = _align_bands(results.frames["bands"], dots)
    dots = dots[dots["j"] % every == 0].set_axis([c.replace("measured_", "") for c in shapes.columns], axis=1)
    parts = [simulated.assign(curve=simulated["method"]), dots.assign(curve="measured")]
    for level in BANDS if role == "validate" else ():
        number = level.removesuffix(" %")
        ends = {f"low_{number}_mm": "low_mm", f"high_{number}_mm": "high_mm"}
        parts.append(bands.rename(columns=ends).assign(curve=level))
    found = pd.concat(
        [part.reindex(columns=_POINT_COLUMNS) for part in parts if len(part)], ignore_index=True
    )
    sides = found["insertion"].map(find_bevel_sides(results))
    found[HEIGHT_COLUMNS] = found[HEIGHT_COLUMNS].mul(sides, axis=0)
    return found.assign(origin=results.origin)


def _align_bands(bands: pd.DataFrame, shapes: pd.DataFrame) -> pd.DataFrame:
    """Return bands as they lie about the measured needle that is drawn.

    Where only the shape is known, scores turn it into a frame of their own: a band stays where it is beside
    the needle it was predicted for.
    """
    parts = []
    ends = [name for name in bands.columns if name.startswith(("low_", "high_"))]
    for key, band in bands.groupby(INSERTION_KEYS, sort=False):
        needle = shapes[(shapes["fold"] == key[0]) & (shapes["insertion"] == key[1])]
        if len(needle):
            height = np.interp(band["x_mm"], needle["measured_x_mm"], needle["measured_y_mm"])
            parts.append(band.assign(**{name: band[name] - band["measured_mm"] + height for name in ends}))
    return pd.concat(parts) if parts else bands


def subtract_fit(points: pd.DataFrame) -> pd.DataFrame:
    """Return all curves except the fit, minus the fit's deflection at the same x."""
    parts = []
    for _, mine in points.groupby(INSERTION_KEYS, sort=False):
        fit = mine[mine["curve"] == "fitted"].dropna(subset="y_mm")
        others = mine[mine["curve"] != "fitted"]
        if len(fit) > 1:
            columns = (frame["x_mm"].to_numpy() for frame in (fit, others))
            height = _extrapolate_height(next(columns), fit["y_mm"].to_numpy(), next(columns))
            parts.append(others.assign(**{name: others[name] - height for name in HEIGHT_COLUMNS}))
    return pd.concat(parts, ignore_index=True) if parts else points.head(0)


def _extrapolate_height(x: Floats, y: Floats, at: Floats) -> Floats:
    """Return a needle's height at `at` (K,), straight on beyond its ends."""
    found: Floats = np.interp(at, x, y)
    for end, neighbour, outside in ((0, 1, at < x[0]), (-1, -2, at > x[-1])):
        slope = (y[end] - y[neighbour]) / (x[end] - x[neighbour])
        found = np.where(outside, y[end] + slope * (at - x[end]), found)
    return found


def _title_panels(results: Run, role: str) -> dict[InsertionKey, str]:
    """Return by fold and insertion what stands above its panel: its tip error."""
    errors = results.frames["errors"].query(
        "role == @role and boundaries == 'measured' and method == 'fitted'"
    )
    titles = {}
    for row in to_records(errors):
        error = f"{format_mm(row['te_mm'], 3 if row['comparison'] == 'aligned' else 2)} mm"
        titles[row["fold"], row["insertion"]] = error if row["converged"] else "did not converge"
    return titles


def _rank_by_tip_error(results: Run, role: str) -> list[InsertionKey]:
    """Return the insertions of a role by the tip error of the fit, smallest first."""
    rows = results.frames["errors"].query(
        "role == @role and boundaries == 'measured' and method == 'fitted' and converged"
    )
    rows = rows.sort_values("te_mm", kind="stable")
    return list(rows[INSERTION_KEYS].itertuples(index=False, name=None))


def find_extremes(results: Run, role: str) -> dict[str, InsertionKey]:
    """Return the insertions with the smallest and the largest tip error; one alone is "only"."""
    keys = _rank_by_tip_error(results, role)
    return {"Only insertion": keys[0]} if len(keys) == 1 else {"Best": keys[0], "Worst": keys[-1]}


def _select(points: pd.DataFrame, chosen: Iterable[InsertionKey]) -> pd.DataFrame:
    inside = pd.MultiIndex.from_frame(points[INSERTION_KEYS]).isin(list(chosen))
    selected: pd.DataFrame = points[inside]
    return selected


def draw_insertions(results: Run, role: str) -> dict[str, Drawing]:
    """Return all insertions; the best and the worst in their layers; three less the fit."""
    titles = _title_panels(results, role)
    names = {method: method_name(method) for method in ("fitted", "hand_tuned")}
    every = _OVERLAY_POINT_STEP if len(titles) <= MAX_LARGE_PANELS else 2 * _OVERLAY_POINT_STEP
    extremes = find_extremes(results, role)
    heads = {which: f"{word}: TE {titles[which]}" for word, which in extremes.items()}
    best = collect_curves(results, role, ("fitted",), _OVERLAY_POINT_STEP)
    best = pd.concat([_select(best, heads), _list_layers(results, heads)], ignore_index=True)
    # a straight line, without coefficients, would hide all others
    curves = (one.name for one in reversed(list_baselines()) if one.scales or one.fit)
    less = {method: method_name(method) for method in ("fitted", "hand_tuned", *curves)}
    ranked = _rank_by_tip_error(results, role)
    three = list(dict.fromkeys([ranked[0], ranked[len(ranked) // 2], ranked[-1]]))
    off = subtract_fit(_select(collect_curves(results, role, less, _RESIDUAL_POINT_STEP), three))
    return {
        "schematic": Drawing(
            insertions,
            best,
            {"heads": heads, "names": {"fitted": names["fitted"]}, "most_columns": 2, "layers": True},
        ),
        "overlays": Drawing(
            insertions, collect_curves(results, role, names, every), {"heads": titles, "names": names}
        ),
        "residuals": Drawing(residuals, off, {"chosen": three, "names": less}),
    }


def _list_layers(results: Run, chosen: Iterable[InsertionKey]) -> pd.DataFrame:
    """Return a row for each layer of some insertions: `curve` is its name, `x_mm` where it begins."""
    stored = results.run.get("layers", {})
    rows = [
        {"fold": fold, "insertion": insertion, "curve": f"{LAYER} {layer:.0f}", "x_mm": float(begin)}
        for fold, insertion in chosen
        for layer, begin in stored.get(insertion, [(1, 0.0)])
    ]
    return pd.DataFrame(rows).assign(origin=results.origin)


# ---- errors on held-out groups

_MIN_TIPS_OF_BOX = 5
"""Fewer tip errors than this are shown as points only: a box of them would be an invention."""

_BOXPLOT_COLUMNS = ("group", "metric", "mark", "insertion", "value", "origin")


def draw_errors(results: Sequence[Run]) -> dict[str, Drawing]:
    """Return the errors by group, of several studies every method's beside them, and the predictive check."""
    marks = pd.DataFrame([row for one in results for row in _list_boxes(one)], columns=_BOXPLOT_COLUMNS)
    drawn = {"boxplot": Drawing(errors_by_group, marks)}
    if len(results) > 1:  # of one study the table of methods has these numbers
        drawn["baselines"] = _draw_baselines(results)
    if any(len(one.frames["predictive"]) for one in results):
        drawn["predicted"] = Drawing(predictive_check, tabulate_predictive_check(results))
    return drawn


def _list_boxes(results: Run) -> Iterator[Row]:
    """Yield what ends, halves and quarters a box, tips, means, floor and the paper's means."""
    where = "role == 'validate' and method == 'fitted' and boundaries == 'measured'"
    cloud, errors = tabulate_points(results).query(where), results.frames["errors"].query(where)
    for group in list_held_out_groups(results):
        medium, layers = group.head["medium"], group.head["layers"]
        about = {"group": f"{_name_group(group)}, n = {group.head['insertions']}", "origin": results.origin}
        ipe, te = (
            frame[(frame["medium"] == medium) & (frame["layers"] == layers) & np.isfinite(frame[column])]
            for frame, column in ((cloud, "ipe_mm"), (errors, TE))
        )
        yield from ({**about, "metric": "IPE", **mark} for mark in _list_quartiles(ipe["ipe_mm"]))
        if len(te) >= _MIN_TIPS_OF_BOX:
            yield from ({**about, "metric": "TE", **mark} for mark in _list_quartiles(te[TE]))
        for tip in to_records(te[["insertion", TE]]):
            place = {"mark": "tip", "insertion": tip["insertion"], "value": tip[TE]}
            yield {**about, "metric": "TE", **place}
        for error, metric in (("IPE", "ipe_mean_mm"), ("TE", TE)):
            for mark, column in (("mean", "value"), ("noise floor", "floor"), ("paper", "paper")):
                if (value := group.get(metric, column)) is not None:
                    yield {**about, "metric": error, "mark": mark, "value": value}


def _name_group(group: ScoredGroup) -> str:
    head = group.head
    return f"{study_name(head['study'])}, {medium_name(head['medium'])}, {layers_name(head['layers'])}"


def _list_quartiles(values: "pd.Series[float]") -> list[Row]:
    if not len(values):
        return []
    ends = np.percentile(values.to_numpy(dtype=np.float64), list(QUARTILES.values()))
    return [{"mark": mark, "value": float(end)} for mark, end in zip(QUARTILES, ends, strict=True)]


def _draw_baselines(results: Sequence[Run]) -> Drawing:
    """Return one row per held-out group with a mark per method, the paper's and the noise floor."""
    rows = [
        {"group": _name_group(group), "method": method, TE: value, "origin": group.head["origin"]}
        for group in list_held_out_groups(*results)
        for method, value in (
            *((method, group.get(TE, method=method)) for method in list_methods()),
            *(("paper", group.get(TE, "paper")), ("noise floor", group.get(TE, "floor"))),
        )
        if value is not None
    ]
    frame = pd.DataFrame(rows, columns=["group", "method", TE, "origin"])
    present = [method for method in list_methods() if (frame["method"] == method).any()]
    middle, step = (len(present) - 1) / 2, 0.6 / max(len(present) - 1, 1)
    looks = {
        method: Look(
            method_name(method),
            method_colour(method),
            method_marker(method),
            shift=step * (place - middle),
            size=5.5 if method == "fitted" else 4,
        )
        for place, method in enumerate(present)
    }
    looks["paper"] = Look("paper, own needles", PAPER_COLOUR, "D", filled=False, size=4)
    looks["noise floor"] = Look("noise floor", INK, "|", dashes=(0, (2, 1.5)), width=0.9)
    options: dict[str, Any] = {
        "rows": ("group",),
        "value": TE,
        "by": "method",
        "looks": looks,
        "scale": "log",
    }
    options |= {"name_row": _break_row, "x_label": "mean tip error (mm)", "row_height": 0.5}
    return Drawing("dots_with_intervals", frame, options)


def _break_row(row: tuple[str, ...]) -> str:
    return row[0].replace(", ", "\n")


# ---- predictive check

BAND_POINTS = 100
"""Number of probabilities at which the band is computed, plus one."""

BAND_ERROR_PROBABILITY = 0.05
"""Probability that uniform PIT values leave the band somewhere."""

_CHECK_COLUMNS = (
    *("study", "mark", "quantity", "probability", "share", "low", "high"),
    *("insertions", "replicates", "origin"),
)


def tabulate_predictive_check(results: Sequence[Run]) -> pd.DataFrame:
    """Return steps of the ECDFs of PIT values, their band, and shares with Wilson intervals.

    The PIT value of a measurement is the probability that was predicted of less: of a tip less far toward
    the bevel, of a shape nearer at its worst point. Where predictions are right it is uniform. A needle is
    one trial, and repeats in one specimen are one where there are specimens enough (`group_independent`).
    """
    rows = [row for one in results if len(one.frames["predictive"]) for row in _list_checks(one)]
    return pd.DataFrame(rows, columns=_CHECK_COLUMNS)


def _list_checks(results: Run) -> Iterator[Row]:
    predictions = results.frames["predictive"]
    groups = group_independent(list(predictions["insertion"]), list(predictions["specimen"]))
    trials = len(set(groups))
    about: Row = {"study": study_name(study_label(results)), "origin": results.origin}
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
    for quantity in PREDICTED_QUANTITIES:
        for level in PREDICTED_LEVELS:
            found = estimate_proportion(list(map(bool, predictions[f"{quantity}_in_{level}"])), groups)
            ends = {"share": found.hits / found.trials, "low": found.low, "high": found.high}
            yield {**about, "mark": "coverage", "quantity": quantity, "probability": level / 100, **ends}


def _orient_pits(results: Run) -> dict[str, Floats]:
    """Return the levels of tips and shapes; those of tips are stored toward +y."""
    predictions = results.frames["predictive"]
    sides = predictions["insertion"].map(find_bevel_sides(results)).to_numpy(dtype=np.float64)
    tips, shapes = (predictions[f"{name}_pit"].to_numpy(dtype=np.float64) for name in ("tip", "shape"))
    # The PIT value of -y is 1 minus that of y: needles whose bevels face opposite sides become comparable.
    return {"tip": np.where(sides > 0, tips, 1 - tips), "shape": shapes}


# ---- search and draws

_END_COLUMNS = ("parameter", "value", "bound_low", "bound_high", "between_bounds")


def draw_starts(results: Run) -> Drawing:
    """Return the objective of all starts above the best one, and where each parameter ended."""
    return Drawing(waterfall, tabulate_starts(results), {"title": describe_counts(results.frames["starts"])})


def tabulate_starts(results: Run) -> pd.DataFrame:
    """Return one row per start and free parameter: rank, objective minus best, and final value.

    Ranks are within a search, best first; starts without a result have none. Only of the fit itself are the
    parameters' ends drawn, so those of other searches are left out.
    """
    starts = results.frames["starts"].astype({"excess": float, "objective": float})
    finite = starts["excess"].where(np.isfinite(starts["excess"]))
    starts["rank"] = finite.groupby([starts["fold"], starts["fit"]], sort=False).rank(method="first")
    known = results.frames["parameters"]
    fitted = known[(known["method"] == "fitted") & (known["status"] == "free")]
    free = to_records(fitted.drop_duplicates("parameter"))
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


def draw_corner(results: Run) -> Drawing:
    """Return the draws of the first fold with the fit, the paper's parameters, the bounds and the ridge."""
    names = {"fitted": "the fit", "hand_tuned": method_name("hand_tuned", results.origin)}
    return Drawing(corner, tabulate_marks(results), {"names_of_sets": names})


def tabulate_marks(results: Run) -> pd.DataFrame:
    """Return what is drawn, Pa and mm: one row per draw, fit, paper's set, bound and end of the ridge."""
    fold = results.frames["draws"]["fold"].iloc[0]
    names = list_free_parameters(results)
    draws = results.frames["draws"].loc[results.frames["draws"]["fold"] == fold, names].assign(mark="draw")
    known = results.frames["parameters"][results.frames["parameters"]["fold"] == fold]
    values = known.pivot_table(index="method", columns="parameter", values="value", sort=False)
    sets = [method for method in DRAWN_SETS if method in values.index]
    bounds = known[known["method"] == "fitted"].set_index("parameter")[["bound_low", "bound_high"]].T
    marks = [
        values.loc[sets].reindex(columns=names).assign(mark=sets),
        bounds.reindex(columns=names).assign(mark=["lower bound", "upper bound"]),
        pd.DataFrame(find_ridge_ends(draws[names])).assign(mark="ridge"),
    ]
    frame = pd.concat([draws, *(part for part in marks if len(part))], ignore_index=True)
    drawn: pd.DataFrame = frame[["mark", *names]]
    return drawn.assign(origin=results.origin)
