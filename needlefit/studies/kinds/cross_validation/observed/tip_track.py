"""Tip tracks that were held out: the verdict is on their readings, which are drawn over depth."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np
import pandas as pd
from scipy.special import stdtrit  # scipy.stats takes 0.4 s to load

from needlefit.reporting.figures import Drawing
from needlefit.reporting.table import Table, TableLayout
from needlefit.reporting.table_files import select_rows, to_records
from needlefit.studies.advice import advise
from needlefit.studies.answer import Check, Finding, Verdict
from needlefit.studies.first_page import FirstPage
from needlefit.studies.fit_frames import PREDICTION_METHOD, FitFrames
from needlefit.studies.fit_tables import TEXT, lay_out_estimates
from needlefit.studies.judge import REFERENCES, check_data, check_intervals, judge_tracks
from needlefit.studies.kinds.cross_validation.observed import ObservationReport
from needlefit.studies.kinds.cross_validation.observed.points import list_overlays
from needlefit.studies.outcome import Outcome
from needlefit.studies.run import Run

# mean error over the runs into a medium; the method's error minus the fitted model's, and its 95 % interval
# (Student)
METHODS_COLUMNS = (
    *("medium", "direction", "method", "runs", "rms_mm", "difference", "low", "high", "better"),
)


def holds_tracks(run: Run) -> bool:
    """Return whether tip tracks were held out."""
    return len(FitFrames.of(run).runs) > 0


def compare_methods_by_run(runs: pd.DataFrame) -> pd.DataFrame:
    """Compare every method with the fitted model on the same predicted runs: the frame "methods"."""
    rows = []
    for place, group in runs.groupby(["medium", "direction"], sort=False):
        wide = group.pivot_table(index="run", columns="method", values="rms_mm", sort=False)
        for method in wide:
            gap = (wide[method] - wide["fitted"]).to_numpy(dtype=np.float64)
            n, half = len(gap), math.nan
            if n > 1:  # half of the 95 % interval of a mean of few differences
                half = float(stdtrit(n - 1, 0.975) * gap.std(ddof=1) / np.sqrt(n))
            difference = (gap.mean(), gap.mean() - half, gap.mean() + half, int((gap > 0).sum()))
            known = (math.nan,) * len(difference) if method == "fitted" else difference
            rows.append((*place, method, n, wide[method].mean(), *known))
    return pd.DataFrame(rows, columns=METHODS_COLUMNS)


@dataclass(frozen=True)
class TrackErrors:
    """What the verdict on predicted tracks states: mean root mean square errors, mm."""

    outcome: Outcome
    rms_mm: float
    curve: str  #: the curve without mechanics that is closest
    curve_mm: float
    runs: int
    registration_depth_mm: float
    faults: bool  #: whether a fit has no bands
    untested: bool  #: whether a run has none, since its guide moved and that of no fitted run did
    tracks: int  #: runs, each along y and along z
    closer: int | None  #: of these, on which the model is closer than the curve; None where it is tested


def judge_readings(run: Run) -> TrackErrors:
    """Judge the predicted tracks by their errors and those of curves."""
    runs = FitFrames.of(run).runs
    outcome = judge_tracks(runs, run.record.margin_mm)
    each = runs.pivot_table(index=["run", "direction"], columns="method", values="rms_mm")
    tested, errors = outcome.is_tested, each.mean()
    curve = str(errors[errors.index.drop("fitted") if tested else list(REFERENCES)].idxmin())
    rms, least = float(errors["fitted"]), float(errors[curve])
    depth = float(run.record.registration_depth_mm)
    ends = select_rows(runs, method="fitted")["tip_95_low_mm"]
    untested = bool(ends.isna().any()) and not run.faults
    closer = None if tested else int((each["fitted"] < each[curve]).sum())
    count = runs["run"].nunique()
    return TrackErrors(
        outcome, rms, curve, least, count, depth, bool(run.faults), untested, len(each), closer
    )


def describe_tracks(run: Run, values: Mapping[str, object]) -> FirstPage:
    """Return how the predicted tracks compare with the baselines, and whether their intervals cover."""
    known, runs = judge_readings(run), FitFrames.of(run).runs
    status = known.outcome.status
    compared = (known.rms_mm, known.curve_mm, known.curve)
    needles = None if known.closer is None else known.tracks
    checks = [
        Finding(
            Check.CURVES,
            known.outcome.passed,
            *compared,
            margin_mm=run.record.margin_mm,
            needles=needles,
            closer=known.closer,
        )
    ]
    names = {"run": "hole", "tip_predicted_mm": "tip_median_mm"}
    predicted = select_rows(runs, method="fitted").rename(columns=names)
    ends = predicted.dropna(subset="tip_95_low_mm")
    if len(ends):
        checks += check_intervals(ends, run.metadata.recipe, len(predicted))
    elif known.untested:
        checks.append(Finding(Check.INTERVALS, None))
    about = asdict(known)
    numbers = {key: about[key] for key in ("outcome", "rms_mm", "curve", "curve_mm", "runs")}
    words = {**values, "tracks": known}
    return FirstPage(
        Verdict(TEXT.sentence("tracks_predicted", words), status, numbers, known.outcome),
        TEXT.sentence("about", words),
        [lay_out_tracks(run), lay_out_estimates(run.frames["parameters"])],
        checks=[*checks, check_data(run)],
        advice=None if status == "pass" else advise(["tracks_missed"], about | {"name": run.name}),
        method=TEXT.sentence("method", words),
    )


def lay_out_tracks(run: Run) -> TableLayout:
    """Return the errors of every method on the same runs."""
    methods = compare_methods_by_run(FitFrames.of(run).runs)
    rows = to_records(methods.replace({"method": {"fitted": PREDICTION_METHOD}}))
    keys = ["medium", "direction"] if methods["direction"].nunique() > 1 else ["medium"]
    columns = (*keys, "runs", "method", "track_error", "track_difference", "better_runs")
    table = Table("tracks", rows, columns, groups=tuple(keys), heads=1 + len(keys), strong="groups")
    return TEXT.lay_out(table, {})


def draw_tracks(run: Run, role: str) -> dict[str, Drawing]:
    """Return every predicted run, the tip at each reading and the guide below it; then those fitted to."""
    readings = Drawing("tip_track", FitFrames.of(run).readings)
    return {"readings": readings, **list_overlays(run, role)}


TIP_TRACK = ObservationReport(
    "tip_track",
    holds_tracks,
    describe_tracks,
    draw_tracks,
    lambda run: [lay_out_tracks(run)],
    lambda run: {"methods": compare_methods_by_run(FitFrames.of(run).runs)},
    lambda run: {"tracks": judge_readings(run)},
)
