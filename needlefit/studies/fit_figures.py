"""The figures of fits and cross-validations as frames: insertions, errors, predictive check, draws."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
import pandas as pd

from needlefit.inference.ecdf_band import ecdf_band
from needlefit.reporting import labels
from needlefit.reporting.figures import (
    BAND_WHITE,
    HEIGHT_COLUMNS,
    INSERTION_KEYS,
    PROFILE_KEYS,
    TIP_ERROR,
    VERDICT_COLUMNS,
    Drawing,
    InsertionKey,
)
from needlefit.reporting.number_format import format_mm
from needlefit.reporting.table_files import Row, select_rows, to_records
from needlefit.schemas.run_metadata import DoubtMetadata
from needlefit.studies import scored_groups as scores
from needlefit.studies.judge import judge
from needlefit.studies.prediction_scores import join_trials
from needlefit.studies.run import FitFrames, Run

# ---- insertions

_POINT_COLUMNS = [*INSERTION_KEYS, "curve", "x_mm", *HEIGHT_COLUMNS]
MAX_PANELS = 48  #: largest number of insertions that have a panel each: a page has room for 12 rows of 4

_OVERLAY_POINT_STEP = 5  # number of compared points of which one is drawn


def collect_curves(
    run: Run, shown: Iterable[str], step: int = 1, *, from_above: bool = False
) -> pd.DataFrame:
    """Return one row per drawn point of the scored insertions: y toward the bevel, mm, or z.

    `curve` is a method of `shown`, "measured" (of the points, one in `step`), or the level of a band, which
    held-out insertions have: `low_mm`, `high_mm` are its ends.
    """
    frames = FitFrames.of(run)
    shapes, bands = frames.select_curves(), frames.bands
    shapes = shapes[shapes["method"].isin(list(shown))]
    if from_above:
        along_z = {f"{name}_y_mm": shapes[f"{name}_z_mm"] for name in ("measured", "simulated")}
        shapes = shapes.assign(**along_z)
        named = [str(name) for name in bands if str(name).endswith("_z_mm")]
        bands = bands.assign(**{name.replace("_z_mm", "_mm"): bands[name] for name in named})
    shapes = shapes.sort_values([*INSERTION_KEYS, "method", "j"])
    simulated = shapes.set_axis([c.replace("simulated_", "") for c in shapes.columns], axis=1)
    dots = shapes.drop_duplicates([*INSERTION_KEYS, "j"])
    bands = _align_bands(bands, dots)
    dots = dots[dots["j"] % step == 0].set_axis([c.replace("measured_", "") for c in shapes.columns], axis=1)
    parts = [simulated.assign(curve=simulated["method"]), dots.assign(curve="measured")]
    for level in BAND_WHITE if frames.role == "validate" else ():
        number = level.removesuffix(" %")
        ends = {f"low_{number}_mm": "low_mm", f"high_{number}_mm": "high_mm"}
        parts.append(bands.rename(columns=ends).assign(curve=level))
    curves = pd.concat(
        [part.reindex(columns=_POINT_COLUMNS) for part in parts if len(part)], ignore_index=True
    )
    sides = curves["insertion"].map(scores.find_bevel_sides(run))
    curves[HEIGHT_COLUMNS] = curves[HEIGHT_COLUMNS].mul(sides, axis=0)
    return curves


def _align_bands(bands: pd.DataFrame, shapes: pd.DataFrame) -> pd.DataFrame:
    """Return bands as they lie about the measured needle that is drawn.

    Where only the shape is known, scores turn it into a frame of their own: a band stays where it is beside
    the needle it was predicted for.
    """
    parts = []
    ends = [name for name in bands.columns if name.startswith(("low_", "high_"))]
    for key, band in bands.groupby(INSERTION_KEYS, sort=False):
        needle = select_rows(shapes, fold=key[0], insertion=key[1])
        if len(needle):
            height = np.interp(band["x_mm"], needle["measured_x_mm"], needle["measured_y_mm"])
            parts.append(band.assign(**{name: band[name] - band["measured_mm"] + height for name in ends}))
    return pd.concat(parts) if parts else bands


def _title_panels(errors: pd.DataFrame) -> dict[InsertionKey, str]:
    """Return by fold and insertion what stands above its panel: its tip error."""
    titles = {}
    for row in to_records(errors):
        error = f"{format_mm(row[scores.TE], 3 if row['comparison'] == 'aligned' else 2)} mm"
        titles[row["fold"], row["insertion"]] = error if row["converged"] else "did not converge"
    return titles


def draw_first_page(run: Run) -> Drawing:
    """Return the figure of the first page: the smallest, middle and largest tip error, and all tip errors."""
    frames = FitFrames.of(run)
    method = frames.method
    fitted = frames.select_errors(method=method)
    curves = collect_curves(run, (method,), _OVERLAY_POINT_STEP)
    is_drawn = fitted["converged"].astype(bool) & fitted["insertion"].isin(curves["insertion"])
    ranked = fitted[is_drawn].sort_values(scores.TE, kind="stable")
    chosen = ranked.iloc[list(dict.fromkeys([0, (len(ranked) - 1) // 2, len(ranked) - 1]))]
    curves = curves.merge(chosen[INSERTION_KEYS], on=INSERTION_KEYS)
    frame = pd.concat([curves, pd.DataFrame(_list_tip_errors(run))], ignore_index=True)
    options = {"heads": _title_panels(chosen), "method": method}
    return Drawing("forms.first_page", frame, options)


def _list_tip_errors(run: Run) -> Iterator[Row]:
    """Yield the tip errors of our method, the compared curve, the paper's parameters; the paper's means."""
    group, frames = scores.pool_insertions(run), FitFrames.of(run)
    assert group is not None
    judged, method = judge(run), frames.method
    names = {method: "our prediction" if frames.role == "validate" else "our fit"}
    curve = "" if judged is None else judged.curve
    names |= {name: labels.method_name(name) for name in (curve, "hand_tuned") if name}
    for key, name in names.items():
        rows = frames.select_errors(method=key, converged=True)
        for row in to_records(rows[["fold", "insertion", scores.TE]]):
            yield {**row, "curve": TIP_ERROR, "method": key, "name": name}
    for scored in scores.list_groups(run):
        if (printed := scored.get(scores.TE, "paper")) is not None:
            yield {
                "curve": TIP_ERROR,
                "method": "paper",
                "name": "paper, own needles",
                scores.TE: printed,
            }
    if (floor := group.get(scores.TE, "floor")) is not None:
        yield {"curve": TIP_ERROR, "method": "noise", "name": "noise", scores.TE: floor}


def select_by_rank(errors: pd.DataFrame, metric: str, count: int) -> pd.DataFrame:
    """Return at most `count` rows at equal steps of the rank of an error, least and largest among them."""
    if len(errors) <= count:
        return errors
    ranked = errors.sort_values(metric, kind="stable").index
    steps = np.linspace(0, len(ranked) - 1, count).round().astype(int)
    return errors.loc[ranked[steps].sort_values()]


def draw_overlays(run: Run, *, from_above: bool = False) -> Drawing:
    """Return at most `MAX_PANELS` insertions by rank of tip errors, seen from the side or from above."""
    frames = FitFrames.of(run)
    ours = frames.method
    errors, drawn = frames.select_errors(method=ours), frames.select_curves()["insertion"]
    errors = select_by_rank(errors[errors["insertion"].isin(drawn)], scores.TE, MAX_PANELS)
    names = {method: labels.method_name(method) for method in (ours, "hand_tuned")}
    curves = collect_curves(run, names, _OVERLAY_POINT_STEP, from_above=from_above)
    curves = curves.merge(errors[INSERTION_KEYS], on=INSERTION_KEYS)
    options: dict[str, object] = {"heads": _title_panels(errors), "names": names}
    options |= {"height": "deflection out\nof the plane (mm)"} if from_above else {}
    return Drawing("forms.insertions", curves, options)


def draw_odd_needles(odd: Sequence[DoubtMetadata]) -> Drawing:
    """Return each of the needles beside what the others predict."""
    heads = {("all", needle.insertion): f"{needle.sds:.2g} SD" for needle in odd}
    columns = [*INSERTION_KEYS, "curve", "x_mm", *HEIGHT_COLUMNS]
    rows = [
        {"fold": "all", "insertion": needle.insertion, "curve": curve, "x_mm": x, "y_mm": y}
        for needle in odd
        for x, *heights in needle.points
        for curve, y in zip(("measured", "fitted"), heights, strict=True)
    ]
    return Drawing(
        "forms.insertions",
        pd.DataFrame(rows, columns=columns),
        {"heads": heads, "names": {"fitted": "predicted from the others"}},
    )


# ---- predictive check

BAND_POINTS = 100  #: number of intervals between the probabilities at which the band is computed
BAND_ERROR_PROBABILITY = 0.05  #: probability that uniform PIT values leave the band somewhere


def draw_predictive_check(run: Run) -> Drawing:
    """Return steps of the ECDFs of PIT values, and their band.

    The PIT value of a measurement is the probability that was predicted of less: of a tip less far toward
    the bevel, of a shape nearer at its worst point. Where predictions are right it is uniform. The band is
    that of the independent trials (`join_trials`). Where they have several insertions, a share may lie
    between two counts: the band is half a count wider, and is left by chance in about 5 % of cases at most,
    however alike insertions of a trial are. One such trial has no band.
    """
    predictions, rows = FitFrames.of(run).predictive, list[Row]()
    groups = pd.Series(join_trials(predictions))
    trials = groups.nunique()
    size = groups.map(groups.value_counts()).to_numpy(dtype=np.float64)
    for quantity, pits in scores.orient_pits(run).items():
        order = np.argsort(pits, kind="stable")
        below = np.cumsum(1 / size[order]) / trials  # every group weighs the same
        rows += [
            {"mark": "ECDF", "quantity": quantity, "probability": float(level), "share": float(part)}
            for level, part in zip([0.0, *pits[order], 1.0], [0.0, *below, 1.0], strict=True)
        ]
    low, high = ecdf_band(trials, BAND_POINTS, BAND_ERROR_PROBABILITY)
    if trials < len(predictions):
        low, high = np.maximum(low - 0.5, 0.0), np.minimum(high + 0.5, trials)
    if trials > 1 or trials == len(predictions):
        rows += [
            {
                "mark": "band",
                "probability": number / BAND_POINTS,
                "low": least / trials,
                "high": most / trials,
            }
            for number, (least, most) in enumerate(zip(low.tolist(), high.tolist(), strict=True), start=1)
        ]
    counts = {"insertions": len(predictions), "replicates": trials}
    return Drawing("forms.predictive_check", pd.DataFrame(rows).assign(**counts))


# ---- profile likelihoods


def draw_profiles(identification: pd.DataFrame, computed: pd.DataFrame) -> Drawing:
    """Return a table of computed points of profiles, beside what is known of their parameters."""
    about = identification[[*PROFILE_KEYS, *VERDICT_COLUMNS]]
    return Drawing("forms.profiles", computed.merge(about, on=PROFILE_KEYS, how="left", sort=False))
