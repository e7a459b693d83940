"""The figures of fits and cross-validations as frames: insertions, errors, predictive check, draws."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
import pandas as pd

from needlefit.arrays import Floats
from needlefit.datasets.select import group_rows
from needlefit.inference.predict import estimate_proportion
from needlefit.reporting import labels
from needlefit.reporting.figures import Drawing
from needlefit.reporting.figures import fit_forms as forms
from needlefit.reporting.number_format import format_mm
from needlefit.reporting.table_files import Row, to_records
from needlefit.studies import scored_groups as scores
from needlefit.studies.fit_frames import select_draws, select_fitted, select_free
from needlefit.studies.judge import choose_method, find_closest_curve
from needlefit.studies.rank_statistics import ecdf_band
from needlefit.studies.run import Run

# ---- insertions

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
    for row in to_records(select_fitted(results.frames["errors"], role, choose_method(results))):
        error = f"{format_mm(row['te_mm'], 3 if row['comparison'] == 'aligned' else 2)} mm"
        titles[row["fold"], row["insertion"]] = error if row["converged"] else "did not converge"
    return titles


def _rank_by_tip_error(results: Run, role: str) -> list[forms.InsertionKey]:
    """Return the insertions of a role by the tip error of the fit, smallest first."""
    rows = select_fitted(results.frames["errors"], role, choose_method(results)).query("converged")
    rows = rows.sort_values("te_mm", kind="stable")
    return list(rows[forms.INSERTION_KEYS].itertuples(index=False, name=None))


def _select(points: pd.DataFrame, chosen: Iterable[forms.InsertionKey]) -> pd.DataFrame:
    inside = pd.MultiIndex.from_frame(points[forms.INSERTION_KEYS]).isin(list(chosen))
    selected: pd.DataFrame = points[inside]
    return selected


def draw_first_page(results: Run, role: str) -> Drawing:
    """Return the figure of the first page: the smallest, middle and largest tip error, and all tip errors."""
    ranked = _rank_by_tip_error(results, role)
    chosen = list(dict.fromkeys([ranked[0], ranked[(len(ranked) - 1) // 2], ranked[-1]]))
    titles, method = _title_panels(results, role), choose_method(results)
    curves = _select(collect_curves(results, role, (method,), _OVERLAY_POINT_STEP), chosen)
    frame = pd.concat([curves, pd.DataFrame(_list_tip_errors(results, role))], ignore_index=True)
    heads = {which: titles[which] for which in chosen}
    return Drawing(forms.first_page, frame.assign(origin=results.origin), {"heads": heads, "method": method})


def _list_tip_errors(results: Run, role: str) -> Iterator[Row]:
    """Yield the tip errors of our method, the closest curve and the paper's parameters; the paper's means."""
    group, method = scores.pool_insertions(results, role), choose_method(results)
    assert group is not None
    curve, errors = find_closest_curve(group), results.frames["errors"]
    here = errors[(errors["role"] == role) & (errors["boundaries"] == "measured")]
    names = {method: "our prediction" if role == "validate" else "our fit"}
    names |= {name: labels.method_name(name) for name in (curve, "hand_tuned") if name}
    for key, name in names.items():
        rows = here[(here["method"] == key) & here["converged"].astype(bool)]
        for row in to_records(rows[["fold", "insertion", scores.TE]]):
            yield {**row, "curve": forms.TIP_ERROR, "method": key, "name": name}
    for one in scores.list_held_out_groups(results):
        if (printed := one.get(scores.TE, "paper")) is not None:
            yield {
                "curve": forms.TIP_ERROR,
                "method": "paper",
                "name": "paper, own needles",
                scores.TE: printed,
            }
    if (floor := group.get(scores.TE, "floor")) is not None:
        yield {"curve": forms.TIP_ERROR, "method": "noise", "name": "noise", scores.TE: floor}


def draw_overlays(results: Run, role: str) -> Drawing:
    """Return all insertions."""
    titles = _title_panels(results, role)
    names = {method: labels.method_name(method) for method in (choose_method(results), "hand_tuned")}
    every = _OVERLAY_POINT_STEP if len(titles) <= MAX_LARGE_PANELS else 2 * _OVERLAY_POINT_STEP
    curves = collect_curves(results, role, names, every)
    return Drawing(forms.insertions, curves, {"heads": titles, "names": names})


# ---- errors on held-out groups

#: fewer tip errors than this are shown as points only: a box of them would be an invention
_MIN_TIPS_OF_BOX = 5

_BOXPLOT_COLUMNS = ("group", "metric", "mark", "insertion", "value", "origin")


def draw_errors(results: Sequence[Run]) -> dict[str, Drawing]:
    """Return the errors on held-out insertions by group, and the predictive check; nothing without any."""
    if scores.tabulate_validation(*results).empty:
        return {}
    marks = pd.DataFrame([row for one in results for row in _list_boxes(one)], columns=_BOXPLOT_COLUMNS)
    drawn = {"boxplot": Drawing(forms.errors_by_group, marks)}
    if any(len(one.frames["predictive"]) for one in results):
        drawn["predicted"] = Drawing(forms.predictive_check, tabulate_predictive_check(results))
    return drawn


def _list_boxes(results: Run) -> Iterator[Row]:
    """Yield what ends, halves and quarters a box, tips, means, floor and the paper's means."""
    method = choose_method(results)
    both = (scores.tabulate_points(results), results.frames["errors"])
    cloud, errors = (select_fitted(frame, "validate", method) for frame in both)
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
                of = method if mark == "mean" else "fitted"
                if (value := group.get(metric, column, of)) is not None:
                    yield {**about, "metric": error, "mark": mark, "value": value}


def _name_group(group: scores.ScoredGroup) -> str:
    study, medium = labels.study_name(group.head["study"]), labels.medium_name(group.head["medium"])
    return f"{study}, {medium}, {labels.layers_name(group.head['layers'])}"


def _list_quartiles(values: "pd.Series[float]") -> list[Row]:
    if not len(values):
        return []
    ends = np.percentile(values.to_numpy(dtype=np.float64), list(forms.QUARTILES.values()))
    return [{"mark": mark, "value": float(end)} for mark, end in zip(forms.QUARTILES, ends, strict=True)]


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


def draw_starts(results: Run) -> Drawing:
    """Return the objective of all starts above the best one."""
    return Drawing(
        forms.waterfall, _tabulate_starts(results), {"title": describe_counts(results.frames["starts"])}
    )


def describe_counts(starts: pd.DataFrame) -> str:
    """Return the number of starts of each search, and the number of searches, as text."""
    sizes = starts.groupby(["fit", "fold"], sort=False).size()
    each = f"{sizes.min()}" if sizes.min() == sizes.max() else f"{sizes.min()} to {sizes.max()}"
    fits, folds = starts["fit"].nunique(), starts["fold"].nunique()
    where = [f"{folds} folds"] if folds > 1 else []
    where += [f"{fits} searches"] if fits > 1 else []
    return f"{each} starts" + (f" in each of {' × '.join(where)}" if where else "")


def _tabulate_starts(results: Run) -> pd.DataFrame:
    """Return one row per start: objective minus best, and the rank in its search; failed ones have none."""
    head = ["fold", "fit", "start", "excess", "within_tolerance"]
    starts = results.frames["starts"].astype({"excess": float, "objective": float})
    finite = starts["excess"].where(np.isfinite(starts["excess"]))
    rank = finite.groupby([starts["fold"], starts["fit"]], sort=False).rank(method="first")
    failed = ~np.isfinite(starts["objective"])
    return starts[head].assign(rank=rank, failed=failed, origin=results.origin)


def tabulate_marks(results: Run) -> pd.DataFrame:
    """Return what is drawn, Pa and mm: one row per draw, fit, paper's set and bound."""
    fold = results.frames["draws"]["fold"].iloc[0]
    names = list(dict.fromkeys(select_free(results.frames["parameters"])["parameter"]))
    draws = select_draws(results.frames["draws"])[names].assign(mark="draw")
    known = results.frames["parameters"][results.frames["parameters"]["fold"] == fold]
    values = known.pivot_table(index="method", columns="parameter", values="value", sort=False)
    sets = [method for method in forms.DRAWN_SETS if method in values.index]
    bounds = known[known["method"] == "fitted"].set_index("parameter")[["bound_low", "bound_high"]].T
    marks = [
        values.loc[sets].reindex(columns=names).assign(mark=sets),
        bounds.reindex(columns=names).assign(mark=["lower bound", "upper bound"]),
    ]
    frame = pd.concat([draws, *(part for part in marks if len(part))], ignore_index=True)
    drawn: pd.DataFrame = frame[["mark", *names]]
    return drawn.assign(origin=results.origin)
