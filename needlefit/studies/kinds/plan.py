"""Plan the insertion that brings the predicted tip to a target, beside plans that use less information.

The plan is the one of least expected squared miss over draws of the posterior (`aiming`). Beside it stand:
aiming straight at the target; the plan at the best fit, which takes its parameters for certain and their
execution for exact; and that of the paper's hand-tuned set. At known parameters many plans hit: it is the one
found first. All are tried on draws that none was sought with, each with the layers on its own path.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, Self

import numpy as np
import pandas as pd
from pydantic import Field, PositiveFloat, model_validator

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion
from needlefit.geometry.crossings import find_crossings
from needlefit.inference.predict import wilson_interval
from needlefit.planning.aiming import (
    Aim,
    ExecutionDraw,
    TargetSite,
    aim_straight,
    draw_execution,
    optimize_aim,
)
from needlefit.planning.goals import PATH_POINTS, Goal, compute_clearances
from needlefit.project.random_streams import random_stream
from needlefit.reporting.figures import Drawing, Look
from needlefit.reporting.labels import PLAN_COLOURS, PLAN_NAMES
from needlefit.reporting.table import Table, part, pivot
from needlefit.reporting.table_files import select_records, to_records
from needlefit.reporting.text import KindText
from needlefit.schemas.planning import EntryPlaneRecord, ObstacleRecord, PlanePoint
from needlefit.studies.further_insertion import (
    FurtherInsertionRecord,
    WeightedPosterior,
    check_reach,
    describe_posterior,
    find_specimen,
    find_template,
    weigh_posterior,
)
from needlefit.studies.held_out_predictions import describe_specimen, describe_spread
from needlefit.studies.job import Job, Settings, prepare
from needlefit.studies.kind import StudyKind
from needlefit.studies.planned_draws import vary_bevels
from needlefit.studies.report import StudyReport
from needlefit.studies.run import Frames, Run, Status, headline_fault
from needlefit.studies.runner import AnalysisPlan, AnalysisTask, FrameRows, Shared, run_analysis
from needlefit.studies.score import Row


class PlanRecord(FurtherInsertionRecord):
    """`kind = "plan"`: the entry that brings the predicted tip to a target."""

    kind: Literal["plan"]
    target_mm: PlanePoint
    """Target, x and y in the plane."""
    tolerances_mm: tuple[PositiveFloat, ...] = Field(default=(1.0, 2.0), min_length=1)
    """Distances for which the probability of a hit is reported."""
    entry_plane: EntryPlaneRecord
    """The plane and what may be chosen in it."""
    obstacles: tuple[ObstacleRecord, ...] = ()
    """Circles that the needle must avoid."""

    @model_validator(mode="after")
    def _within_reach(self) -> Self:
        """Refuse what no needle of these depths reaches, however it bends."""
        (x, y), (low, high) = self.target_mm, self.entry_plane.offset_mm
        deepest = self.entry_plane.depth_mm[1]
        away = math.hypot(x, y - min(max(y, low), high))
        if x <= 0:
            raise ValueError(f"target_mm lies before the entrance, x = 0: x is {x:g} mm")
        if away > deepest + max(self.tolerances_mm):
            raise ValueError(
                f"target_mm is {away:.1f} mm from the nearest entry that offset_mm allows; depth_mm ends "
                f"at {deepest:g} mm"
            )
        return self


KIND = StudyKind("plan", PlanRecord, __name__)

SEARCH_DRAWS, TEST_DRAWS = 60, 1000  #: draws on which a plan is sought, and others on which it is tried
FIGURE_NEEDLES = 80  #: needles of the plan that are kept to be drawn
BOUND_TOLERANCE = 0.05  #: values nearer to a bound, mm or degrees, are printed as the bound
LAYER_RAYS = 121  #: lines along x on which the layers of the plane are found

EXPECTED, BEST_FIT, HAND_TUNED, STRAIGHT = "expected", "best_fit", "hand_tuned", "straight"
TARGET = "target"

_PLAN_COLUMNS = {"offset": "offset_mm", "angle": "angle_deg", "depth": "depth_mm"}
_MISS_COLUMNS = ("median_mm", "miss_95_mm", "rms_mm", "bias_x_mm", "bias_y_mm", "spread_mm")
#: `exceedances` is the share of needles that miss by more than `limit_mm`, or, where `object` names an
#: obstacle, that touch it, with Wilson's 95 % interval. `needles` of trial -1 are those of the mean
#: parameters, executed as planned. `miss_95_mm` is what 95 % of needles miss by at most; the bias is the mean
#: tip less the target.
FRAMES: Mapping[str, tuple[str, ...]] = {
    "plans": (
        *("method", "offset_mm", "angle_deg", "depth_mm", "bevel_side", "search_rms_mm"),
        *("draws", "failed_solves", *_MISS_COLUMNS),
    ),
    "exceedances": ("method", "object", "limit_mm", "share", "low", "high"),
    "misses": ("method", "trial", "x_mm", "y_mm", "miss_mm"),
    "needles": ("method", "trial", "x_mm", "y_mm"),
    "layers": ("y_mm", "interval", "layer", "low_mm", "high_mm"),
    "posterior": (
        *("insertions", "pareto_k", "sampled", "draws", "ess", "note"),
        *(
            "specimen_treatment",
            "between_sd_ln_mu",
            "between_sd_ln_b",
            "between_correlation",
            "other_specimens",
        ),
    ),
}


@dataclass(frozen=True)
class _PlanningDraws:
    """The posterior at planning time, and the draws that plans are optimised and tested on."""

    job: Job
    record: PlanRecord
    site: TargetSite
    knowledge: WeightedPosterior
    search_draws: tuple[ExecutionDraw, ...]
    test_draws: tuple[ExecutionDraw, ...]


GetDraws = Callable[[], _PlanningDraws | None]


def run(name: str, record: PlanRecord, settings: Settings) -> Run:
    """Return the plan of a study and its expected miss, beside those of other plans.

    Raises ConfigError or DataError if anything the record names is missing or wrong. FitError if the fit has
    no solution.
    """
    job = prepare(name, record.tuning(), settings)
    site = make_site(job, record)
    check_reach(job, site.like, {"entry_plane.depth_mm": record.entry_plane.depth_mm[1]})
    into = find_specimen(job, site.like, record.specimen)
    known = Shared(partial(_draw_executions, job, record, site, into, settings))
    names = [EXPECTED, BEST_FIT, *([HAND_TUNED] if job.hand_tuned is not None else []), STRAIGHT]
    tasks: dict[str, AnalysisTask] = {
        "posterior": partial(_posterior_row, known),
        **{one: partial(_run_task, known, one, settings) for one in names},
        "layers": partial(_layer_rows, site),
    }
    conclude = partial(_conclude, max(record.tolerances_mm))
    plan = AnalysisPlan([job], tasks, FRAMES, conclude, shared=[known])
    return run_analysis(name, record, settings, plan)


def make_site(job: Job, record: PlanRecord) -> TargetSite:
    goal = Goal(record.target_mm, obstacles=record.obstacles)
    like = find_template(job, record.template_insertion)
    return TargetSite(job.medium, job.dataset.needle, like, record.entry_plane, goal)


def _draw_executions(
    job: Job, record: PlanRecord, site: TargetSite, into: Insertion | None, settings: Settings
) -> _PlanningDraws | None:
    found = weigh_posterior(job, into, settings)
    if found is None:
        return None
    # search and test use different draws: a plan must not be tried on the draws it was fitted to
    even = np.arange(len(found.thetas)) % 2 == 0
    search_draws = draw_trials(job, site.like, found.only(even), SEARCH_DRAWS)
    test_draws = draw_trials(job, site.like, found.only(~even), TEST_DRAWS)
    return _PlanningDraws(job, record, site, found, search_draws, test_draws)


def draw_trials(job: Job, like: Insertion, known: WeightedPosterior, count: int) -> tuple[ExecutionDraw, ...]:
    """Return draws of parameters and of errors; other counts are other draws."""
    rng = random_stream(job.recipe.seed, job.name, "trials", count)
    thetas = known.thetas[known.drawn(count, rng)]
    sets = vary_bevels([known.problem.values(theta) for theta in thetas], known.bevel_sd, rng)
    return tuple(draw_execution(values, like, rng) for values in sets)


def _posterior_row(known: GetDraws) -> FrameRows:
    now = known()
    if now is None:
        return {}
    about = describe_specimen(now.knowledge.new)
    return {"posterior": [describe_posterior(now.knowledge) | about]}


def _run_task(known: GetDraws, name: str, settings: Settings) -> FrameRows:
    """Return one plan, and what became of its needles; nothing of these where the draws are not certified."""
    now = known()
    if now is None:
        return {}
    aimed = _find_aim(now, name)
    if settings.stop():
        return {}
    return _result_rows(now, name, aimed, [now.site.execute(aimed, one) for one in now.test_draws])


def _find_aim(now: _PlanningDraws, name: str) -> Aim:
    site, plane = now.site, now.record.entry_plane
    if name == EXPECTED:
        return optimize_aim(site, now.search_draws, now.knowledge.middle)
    if name == STRAIGHT:
        return aim_straight(plane, site.goal.target, float(np.clip(0, *plane.angle_deg)), 1)
    values = dict(now.knowledge.learned.fit.values if name == BEST_FIT else now.job.hand_tuned or {})
    return optimize_aim(site, [ExecutionDraw(values)], values)


def _result_rows(now: _PlanningDraws, name: str, aim: Aim, paths: list[Floats | None]) -> FrameRows:
    middle = now.knowledge.middle
    solved = {number: path for number, path in enumerate(paths) if path is not None}
    tips = np.array([path[-1] for path in solved.values()]).reshape(-1, 2)
    off = tips - now.record.target_mm
    misses = np.linalg.norm(off, axis=1)
    (nominal,) = now.site.find_paths(aim, [ExecutionDraw(middle)], middle)
    row = _plan_row(name, aim, off, len(paths) - len(solved))
    if now.knowledge.learned.draws.faults:
        row |= dict.fromkeys(_MISS_COLUMNS)
        solved, tips, misses = {}, tips[:0], misses[:0]
    fan = dict(list(solved.items())[:FIGURE_NEEDLES]) if name == EXPECTED else {}
    drawn = {**({} if nominal is None else {-1: nominal}), **fan}
    head = {"method": name}
    return {
        "plans": [row],
        "exceedances": _exceedance_rows(now.record, name, misses, list(solved.values())),
        "misses": [
            {**head, "trial": number, "x_mm": x, "y_mm": y, "miss_mm": miss}
            for number, (x, y), miss in zip(solved, tips.tolist(), misses.tolist(), strict=True)
        ],
        "needles": [
            {**head, "trial": number, "x_mm": x, "y_mm": y}
            for number, path in drawn.items()
            for x, y in path.tolist()
        ],
    }


def _plan_row(name: str, aim: Aim, off: Floats, failed: int) -> Row:
    """Return one plan and its misses; `off` (B, 2) are the tips less the target."""
    chosen: Row = {"method": name, "offset_mm": aim.offset, "angle_deg": aim.angle, "depth_mm": aim.depth}
    chosen |= {"bevel_side": aim.side, "search_rms_mm": aim.rms}
    chosen |= {"draws": len(off) + failed, "failed_solves": failed}
    if not len(off):
        return chosen
    misses, bias = np.linalg.norm(off, axis=1), off.mean(axis=0)
    spread = np.sqrt(np.mean(np.sum((off - bias) ** 2, axis=1)))
    quantiles = np.quantile(misses, [0.5, 0.95])
    found = (*quantiles, np.sqrt(np.mean(misses**2)), *bias, spread)
    return chosen | dict(zip(_MISS_COLUMNS, map(float, found), strict=True))


def at_bounds(entry_plane: EntryPlaneRecord, row: Row) -> tuple[str, ...]:
    """Return which values of a plan lie at a bound of the study file, at the precision of the tables."""
    return tuple(
        name
        for name, ends in entry_plane.ranges.items()
        if min(abs(row[_PLAN_COLUMNS[name]] - end) for end in ends) < BOUND_TOLERANCE
    )


def _exceedance_rows(record: PlanRecord, name: str, misses: Floats, paths: list[Floats]) -> list[Row]:
    """Return how many needles miss by more than each tolerance, and how many touch an obstacle."""
    held = [(TARGET, limit, misses > limit) for limit in record.tolerances_mm]
    for one in record.obstacles:
        held.append((one.name, 0.0, compute_clearances(np.array(paths).reshape(-1, PATH_POINTS, 2), one) < 0))
    rows = []
    for what, limit, wrong in held:
        row: Row = {"share": None, "low": None, "high": None}
        if len(wrong):
            rate = float(wrong.mean())
            row = dict(zip(row, (rate, *wilson_interval(rate, len(wrong))), strict=True))
        rows.append({"method": name, "object": what, "limit_mm": limit, **row})
    return rows


def _layer_rows(site: TargetSite) -> FrameRows:
    """Return the layers of the plane, on lines along x; nothing where the dataset has no surfaces."""
    if not site.like.surfaces:
        return {}
    entry_plane, (x, y) = site.entry_plane, site.goal.target
    half = max(abs(entry_plane.offset_mm[0]), abs(entry_plane.offset_mm[1]), abs(y)) + 5.0
    far = max(entry_plane.depth_mm[1], x) + 5.0
    rows = []
    for height in np.linspace(-half, half, LAYER_RAYS).tolist():
        ends = site.plane.to_world(np.array([[0.0, height, 0.0], [far, height, 0.0]]))
        met = find_crossings(ends, site.like.surfaces)
        stops = [0.0, *met.arc.tolist(), far]
        for k, layer in enumerate(met.sequence):
            place = {"y_mm": height, "interval": k, "layer": layer}
            rows.append({**place, "low_mm": stops[k], "high_mm": stops[k + 1]})
    return {"layers": rows}


def _conclude(limit: float, frames: Frames) -> tuple[str, ...]:
    plans = frames["plans"]
    lost = plans[plans["failed_solves"].astype(float) > 0]
    failed = [
        f"{row.failed_solves} of {row.draws} needles of plan {row.method} have no solution"
        for row in lost.itertuples()
    ]
    median = float(plans.set_index("method")["median_mm"].astype(float)[EXPECTED])
    notes = tuple(fault for fault in frames["posterior"]["note"] if fault)
    if notes or reaches(median, limit):  # no misses: no sentence on them
        return (*notes, *failed)
    missed = f"half of the needles of the best one miss by more than {median:.1f} mm"
    if not np.isfinite(median):
        missed = "no needle of the best one has a solution"
    return (f"no plan within these bounds comes within {limit:g} mm of the target: {missed}", *failed)


def reaches(median: float | None, limit: float) -> bool:
    """Return whether at least half of a plan's needles come within `limit` mm; False if none is solved."""
    return median is not None and median <= limit


# ---- the report


def describe(result: Run) -> dict[str, Any]:
    """Return what the text prints."""
    record, plane = result.record, result.record.entry_plane
    plans = [
        {**row, "name": PLAN_NAMES[str(row["method"])], "at_bounds": at_bounds(plane, row)}
        for row in to_records(result.frames["plans"])
    ]
    exceeded = to_records(result.frames["exceedances"])
    (posterior,) = to_records(result.frames["posterior"])
    of_others = posterior["specimen_treatment"] == "others"
    return {
        "ours": next(row for row in plans if row["method"] == EXPECTED),
        "others": [row for row in plans if row["method"] != EXPECTED],
        "certified": not posterior["note"],
        "reached": rate_reach(result),
        "limit_mm": max(record.tolerances_mm),
        "target": record.target_mm,
        "exceedances": [row for row in exceeded if row["method"] == EXPECTED],
        "marked": any(row["at_bounds"] for row in plans),
        "posterior": posterior,
        "specimen": describe_spread(posterior) if of_others else "",
        "ranges": [
            {"name": name, "unit": "°" if name == "angle" else " mm", "low": low, "high": high}
            for name, (low, high) in plane.ranges.items()
        ],
    }


def rate_reach(result: Run) -> bool:
    """Return whether at least half of the plan's needles come within the largest tolerance."""
    (ours,) = select_records(result.frames["plans"], method=EXPECTED)
    return reaches(ours["median_mm"], max(result.record.tolerances_mm))


def rate(result: Run) -> Status:
    """Return "warn" if no plan reaches the target, or the plan lies at a bound of the study."""
    (ours,) = select_records(result.frames["plans"], method=EXPECTED)
    return "pass" if rate_reach(result) and not at_bounds(result.record.entry_plane, ours) else "warn"


def tabulate(result: Run) -> list[Table]:
    """Return the plans with their misses, and how often they miss by more than the tolerance."""
    found = describe(result)
    rows = [
        {
            **row,
            **{f"{name}_mark": "*" if name in row["at_bounds"] else "" for name in _PLAN_COLUMNS},
            "plan": row["name"],
            "bevel_side": "+y" if row["bevel_side"] > 0 else "−y",
        }
        for row in (found["ours"], *found["others"])
    ]
    columns = (
        *("plan", *(f"aimed_{name}" for name in _PLAN_COLUMNS), "bevel_side", "half_miss", "miss_95"),
        *("rms_mm", "bias", "miss_spread"),
    )
    plans = Table("plans", rows, columns, strong="first")
    if not found["certified"]:
        return [plans]
    events = []
    for row in to_records(result.frames["exceedances"]):
        missed = row["object"] == TARGET
        event = f"misses by > {row['limit_mm']:g} mm" if missed else f"touches {row['object']}"
        events.append({**row, "plan": PLAN_NAMES[str(row["method"])], "event": event})
    every = dict.fromkeys(row["event"] for row in events)
    shares = (part("exceedance_share", event=event) for event in every)
    lines = pivot(events, ["plan"], ["event"])
    return [plans, Table("exceedances", lines, ("plan", *shares), strong="first")]


def draw(result: Run) -> dict[str, Drawing]:
    """Return the plan in its plane, and the share of needles of each plan within a distance."""
    looks = {
        name: Look(words, PLAN_COLOURS[name], dashes="-" if name == EXPECTED else (0, (5, 2)))
        for name, words in PLAN_NAMES.items()
    }
    options = {"by": "method", "looks": looks, "main": EXPECTED}
    plane = {"plane": Drawing("plan_in_plane", _tabulate_plane(result), options)}
    if not len(result.frames["misses"]):
        return plane
    labels = {"value": "miss_mm", "x_label": "miss of the tip (mm)", "y_label": "share of needles"}
    within = Drawing("shares_within", _tabulate_misses(result), {**options, **labels})
    return {**plane, "within": within}


def _tabulate_plane(result: Run) -> pd.DataFrame:
    """Return needles, tips of the plan, layers, and the circles about target and obstacles."""
    record, frames = result.record, result.frames
    circles = [("tolerance", "", record.target_mm, limit) for limit in record.tolerances_mm]
    circles += [("obstacle", one.name, one.centre_mm, one.radius_mm) for one in record.obstacles]
    rows = [
        {"mark": mark, "object": name, "x_mm": x, "y_mm": y, "radius_mm": radius}
        for mark, name, (x, y), radius in circles
    ]
    tips = frames["misses"][frames["misses"]["method"] == EXPECTED]
    parts = [frames["needles"].assign(mark="needle"), tips.assign(mark="tip")]
    parts += [frames["layers"].assign(mark="layer"), pd.DataFrame(rows)]
    columns = (
        *("mark", "method", "trial", "x_mm", "y_mm", "object", "radius_mm"),
        *("interval", "layer", "low_mm", "high_mm"),
    )
    every = [one.reindex(columns=list(columns)) for one in parts if len(one)]
    whole = dict.fromkeys(("trial", "interval", "layer"), "Int64")
    return pd.concat(every, ignore_index=True).astype(whole).assign(origin=result.origin)


def _tabulate_misses(result: Run) -> pd.DataFrame:
    """Return the steps of each plan's share of needles, and the tolerances."""
    parts = []
    for name, rows in result.frames["misses"].groupby("method", sort=False):
        miss = np.sort(rows["miss_mm"].to_numpy(dtype=np.float64))
        share = np.arange(1, len(miss) + 1) / len(miss)
        parts.append(pd.DataFrame({"mark": "needles", "method": name, "miss_mm": miss, "share": share}))
    parts.append(pd.DataFrame({"mark": "tolerance", "miss_mm": result.record.tolerances_mm}))
    return pd.concat(parts, ignore_index=True).assign(origin=result.origin)


REPORT = StudyReport(
    KindText("plan"),
    describe,
    tabulate,
    draw,
    rate=rate,
    # a target out of reach is the verdict itself
    headline=lambda fault: "" if fault.startswith("no plan") else headline_fault(fault),
)
