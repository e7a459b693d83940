"""Rank candidates for the next insertion by their expected information gain, beside a repeat.

The gain of a candidate is the mutual information of parameters and its data, by nested Monte Carlo over the
posterior of what is known already (`inference.identifiability.design_gain`); its linear form stands beside
it. Errors of pose, depths and points are those of the insertion that the study names as a model of a new one.
All go into one specimen; the gain is about its parameters and tips (`further_insertion.find_specimen`).
All candidates predict data for the same draws: their differences are better known than their values.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Any, Literal, Self

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import Field, model_validator
from scipy.stats import spearmanr

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion
from needlefit.datasets.layers import select_layers
from needlefit.errors import ConfigError, FitError
from needlefit.geometry.frames import Frame, make_entry_frame, normalize
from needlefit.inference.forward_model import make_batch, predict
from needlefit.inference.identifiability import directions, precision
from needlefit.inference.identifiability.design_gain import (
    ExpectedGain,
    PredictedData,
    linearized_gain,
    nested_gain,
)
from needlefit.inference.identifiability.identify import find_fixed_shape, free_shape
from needlefit.inference.likelihood.nodes import make_group
from needlefit.inference.parameters import BEVEL_SPREAD, NOISE_SCALE, is_logarithmic
from needlefit.inference.planned_layers import with_planned_layers
from needlefit.inference.problem import Problem
from needlefit.mechanics.batch import compute_batch_positions, simulate_batches
from needlefit.mechanics.shape import sample_inserted_points
from needlefit.project.random_streams import random_stream
from needlefit.project.toml import describe_key
from needlefit.reporting.figures import Drawing, Look, Panel
from needlefit.reporting.labels import INK, SERIES_COLOURS, entry_name
from needlefit.reporting.number_format import format_bare_symbol, format_symbol, insert_symbols
from needlefit.reporting.table import Table, part, pivot
from needlefit.reporting.table_files import select_records, to_records
from needlefit.reporting.text import KindText
from needlefit.schemas.base import Name, Record
from needlefit.schemas.limits import MAX_CANDIDATES, MAX_LAYERS, MAX_NEEDLE_LENGTH_MM
from needlefit.schemas.planning import Vector
from needlefit.studies import further_insertion
from needlefit.studies.held_out_predictions import Specimens
from needlefit.studies.job import Fold, Job, Settings, prepare
from needlefit.studies.kind import StudyKind
from needlefit.studies.planned_draws import vary_bevels
from needlefit.studies.report import StudyReport
from needlefit.studies.run import Frames, Run
from needlefit.studies.runner import AnalysisPlan, AnalysisTask, FrameRows, Shared, run_analysis
from needlefit.studies.score import Row
from needlefit.studies.simulated_data import simulate_design


class CandidateEntryRecord(Record):
    """An entry position of candidate insertions."""

    name: Name
    """Name of the entry in tables."""
    position_mm: Vector = (0.0, 0.0, 0.0)
    """Position in the world."""
    direction: Vector = (1.0, 0.0, 0.0)
    """Direction of the needle at angle 0, in the world."""
    bending_direction: Vector = (0.0, 1.0, 0.0)
    """Direction across it that the bevel faces, in the world."""
    angles_deg: tuple[float, ...] = Field(default=(0.0,), min_length=1, max_length=MAX_CANDIDATES)
    """Candidate angles, from `direction` toward `bending_direction`."""
    depths_mm: tuple[float, ...] | None = Field(default=None, max_length=MAX_CANDIDATES)
    """Candidate depths at this entry, in place of those of the study."""
    layers: tuple[int, ...] | None = Field(default=None, max_length=MAX_LAYERS)
    """Layers that are met, in place of those of the dataset's surfaces; then there is one angle."""
    boundaries_mm: tuple[float, ...] = ()
    """Depths of the boundaries between `layers`."""

    @model_validator(mode="after")
    def _layers_whole(self) -> Self:
        if self.layers is None and self.boundaries_mm:
            raise ValueError("boundaries_mm parts the layers that `layers` lists; there are none")
        if self.layers is not None and len(self.layers) != len(self.boundaries_mm) + 1:
            raise ValueError("n layers are parted by n - 1 depths in boundaries_mm")
        if self.layers is not None and len(self.angles_deg) != 1:
            raise ValueError("angles need surfaces: with `layers` there is one, and it changes nothing")
        return self


class QuantityRecord(Record):
    """The tip deflection of an insertion, as a quantity of interest."""

    name: Name
    """Name of the quantity in tables."""
    entry: str
    """Entry of the insertion whose tip deflection is predicted."""
    depth_mm: float = Field(gt=0, le=MAX_NEEDLE_LENGTH_MM)
    """Its depth."""
    angle_deg: float = 0.0
    """Its angle."""


class NextInsertionRecord(further_insertion.FurtherInsertionRecord):
    """`kind = "next_insertion"`: the insertion with the largest expected information gain."""

    kind: Literal["next_insertion"]
    depths_mm: tuple[float, ...] = Field(min_length=1, max_length=MAX_CANDIDATES)
    """Candidate depths."""
    entries: tuple[CandidateEntryRecord, ...] = Field(min_length=1, max_length=MAX_CANDIDATES)
    """Candidate entries."""
    quantities: tuple[QuantityRecord, ...] = ()
    """Tip deflections, in the specimen of the candidates, whose uncertainty is to be reduced; without it,
    that of its parameters."""

    @model_validator(mode="after")
    def _names(self) -> Self:
        names = [entry.name for entry in self.entries]
        if len(set(names)) < len(names):
            raise ValueError("two entries have one name")
        lost = [q.entry for q in self.quantities if q.entry not in names]
        if lost:
            raise ValueError(f"quantities name no entry: {', '.join(lost)}")
        return self


KIND = StudyKind("next_insertion", NextInsertionRecord, __name__)

OUTER_DRAWS = 400  #: draws whose data are predicted; their scatter is the standard error of a gain
LINEAR_DRAWS = 24  #: draws at which the linear gain is taken; it is their mean
MIN_ESS = 10.0  #: effective sample size that a posterior must have in the median; rows with less are marked
ROUGH_NOTE = "rough"
LEAST_KNOWN = "least_known"  #: name of the combination of parameters that is known worst
MEASURED_POINTS = 31  #: of a candidate: neighbours err alike, so that more add next to nothing
BENT_RIDGE_NATS = 0.3  #: excess of a linear gain above which the ridge is called curved: several SEs
REPEAT = "repeat"

_WHERE = ("role", "entry", "angle_deg", "depth_mm")
FRAMES: Mapping[str, tuple[str, ...]] = {
    "candidates": (
        *_WHERE,
        *("layers", "boundaries_mm", "deflection_mm", "nats", "nats_se", "linear_nats"),
        *("ess", "draws", "failed_solves", "note"),
    ),
    "parameters": (*_WHERE, "parameter", "combination", "sd_now", "sd_after", "nats"),
    "tips": (*_WHERE, "tip", "sd_now_mm", "sd_after_mm", "nats"),
    "alphas": (*_WHERE, "parameter", "sd_now", "sd_after"),
    "posterior": ("insertions", "pareto_k", "sampled", "draws", "ess", "note"),
}
"""`role` is "candidate", or "repeat": the deepest insertion so far (into its specimen), once more. Deviations
of parameters are of logarithms, of alpha itself; those of `alphas` are what would be left if all else were
known. `ess` is on how many draws the posterior afterwards stands."""

AGREEMENT_COLUMNS = ("candidates", "spearman", "largest_excess_nats", "same_best")
"""Columns of the agreement of the linear gain with the nested one over the candidates."""

# ---- candidates

CandidatePlace = tuple[CandidateEntryRecord, float, float]  #: entry, angle (degrees) and depth (mm)


def predict_candidate(
    job: Job, like: Insertion, place: CandidatePlace, values: Mapping[str, float]
) -> Insertion | None:
    """Return a candidate as `values` (Pa, mm) predict it; None if it has no solution or leaves the medium.

    The layers are those that the predicted needle meets, the same for all draws of the parameters: as it will
    be once they are measured.

    Raises ConfigError if nothing says which layers it meets.
    """
    entry, angle, depth = place
    planned = replace(like, id=entry.name, depth=depth, frame=frame_of(entry, angle))
    if entry.layers is not None:
        boundaries, met = select_layers(np.array(entry.boundaries_mm, dtype=np.float64), depth)
        sequence = entry.layers[: len(met)]
        through = replace(planned, boundaries=boundaries, sequence=sequence)
        return None if max(sequence) > job.medium.layers else with_predicted_shape(job, through, values)
    if not planned.surfaces:
        raise ConfigError(
            f"medium {planned.medium} has no surfaces: the layers at entry `{entry.name}` are not known",
            where=describe_key(job.name, "entries"),
            key="entries",
            fix="list the entry's `layers`, and their boundaries_mm",
        )
    met_layers = with_planned_layers(planned, values, job.medium, job.dataset.needle)
    return None if met_layers is None else with_predicted_shape(job, met_layers, values)


def with_predicted_shape(job: Job, insertion: Insertion, values: Mapping[str, float]) -> Insertion | None:
    """Return an insertion with the shape that `values` predict as the measured one; None if there is none."""
    needle = predict(values, job.medium, job.dataset.needle, insertion)
    if not needle.converged:
        return None
    return replace(insertion, planar=sample_inserted_points(needle, MEASURED_POINTS), sections=None)


def frame_of(entry: CandidateEntryRecord, angle: float) -> Frame:
    """Return the frame C in the world at an entry, with x turned by `angle` (degrees) to the bevel side."""
    x = normalize(entry.direction)
    y = make_entry_frame(entry.position_mm, x, entry.bending_direction).rotation[:, 1]
    cos, sin = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    return make_entry_frame(entry.position_mm, cos * x + sin * y, cos * y - sin * x)


# ---- what they are expected to tell


@dataclass(frozen=True)
class _CurrentKnowledge:
    """What is known before the next insertion."""

    job: Job
    known: further_insertion.WeightedPosterior
    ridge: Floats  #: (P,) the unit combination of theta that is known worst
    tips: Floats  #: (B, T) deflections of the tips asked for, mm
    outer_draws: NDArray[np.intp]  #: (O,) draws whose data are predicted

    @property
    def quantities(self) -> Floats:
        """Parameters, the combination known worst, tips: (B, P + 1 + T)."""
        thetas = self.known.thetas
        return np.column_stack([thetas, thetas @ self.ridge, self.tips])

    def only(self, kept: NDArray[np.bool_]) -> "_CurrentKnowledge":
        """Return the same of the draws of a mask (B,) alone."""
        # new numbers of the draws that stay
        places = np.cumsum(kept) - 1
        outer_draws = places[self.outer_draws[kept[self.outer_draws]]]
        return replace(self, known=self.known.only(kept), tips=self.tips[kept], outer_draws=outer_draws)


GetKnowledge = Callable[[], _CurrentKnowledge | None]
PredictInsertion = Callable[[Mapping[str, float]], Insertion | None]
"""Values (Pa, mm) -> an insertion with the shape that they predict; None where there is none."""


def run(name: str, record: NextInsertionRecord, settings: Settings) -> Run:
    """Rank the candidates of a study."""
    job = prepare(name, record.tuning(), settings)
    like = further_insertion.find_template(job, record.template_insertion)
    depths = {"depths_mm": record.depths_mm}
    depths |= {f"entries.{n}.depths_mm": one.depths_mm or () for n, one in enumerate(record.entries, start=1)}
    depths |= {
        f"quantities.{n}.depth_mm": (one.depth_mm,) for n, one in enumerate(record.quantities, start=1)
    }
    further_insertion.check_reach(job, like, {key: max(values) for key, values in depths.items() if values})
    into = further_insertion.find_specimen(job, like, record.specimen)
    made = Specimens(job, job.folds[0]).problem_of(into).insertions
    deepest = max(made, key=lambda one: one.depth)
    now = Shared(partial(_find_knowledge, job, record, like, into, settings))
    names = tuple(one.name for one in record.quantities)
    tasks: dict[str, AnalysisTask] = {"posterior": partial(_describe_now, now)}
    for entry in record.entries:
        for angle, depth in product(entry.angles_deg, entry.depths_mm or record.depths_mm):
            where = dict(zip(_WHERE, ("candidate", entry.name, angle, depth), strict=True))
            predict_new = partial(predict_candidate, job, like, (entry, angle, depth))
            key = f"{entry.name}, {angle:g} degrees, {depth:g} mm"
            tasks[key] = partial(_run_task, now, where, names, predict_new)
    where = dict(zip(_WHERE, ("repeat", deepest.id, 0.0, deepest.depth), strict=True))
    tasks["repeat"] = partial(_run_task, now, where, names, partial(_predict_repeat, job, deepest))
    plan = AnalysisPlan([job], tasks, FRAMES, _conclude, shared=[now])
    return run_analysis(name, record, settings, plan)


def _describe_now(now: GetKnowledge) -> FrameRows:
    before = now()
    return {} if before is None else {"posterior": [further_insertion.describe_posterior(before.known)]}


def _predict_repeat(job: Job, made: Insertion, values: Mapping[str, float]) -> Insertion | None:
    """Return an insertion as it would go once more."""
    again = simulate_design(job, Fold("again", (made,), ()), values)
    if again is None:
        return None
    return with_predicted_shape(job, replace(again.insertions[0], sd=None), values)


def _find_knowledge(
    job: Job, record: NextInsertionRecord, like: Insertion, into: Insertion | None, settings: Settings
) -> _CurrentKnowledge | None:
    fitted = further_insertion.weigh_posterior(job, into, settings)
    if fitted is None:
        return None
    known = refer_to_all_needles(fitted, random_stream(job.recipe.seed, job.name, "bevels"))
    entries, tips = {entry.name: entry for entry in record.entries}, []
    for wanted in record.quantities:
        place = (entries[wanted.entry], wanted.angle_deg, wanted.depth_mm)
        insertion = predict_candidate(job, like, place, known.middle)
        if insertion is None:
            raise FitError(f"the insertion of `{wanted.name}` has no solution, or leaves the medium")
        batch = make_batch(known.sets, known.problem.medium, known.problem.dataset.needle, insertion)
        (shapes,) = simulate_batches([batch], 1)
        deflections = compute_batch_positions(shapes, np.array([insertion.depth]))[:, 0, 1]
        tips.append(np.where(shapes.converged, deflections, np.nan))  # (B,) mm
    found = np.array(tips).reshape(len(tips), len(known.thetas))
    solved = np.asarray(np.isfinite(found).all(axis=0), dtype=np.bool_)
    kept = known.only(solved)
    outer_draws = kept.drawn(OUTER_DRAWS, random_stream(job.recipe.seed, job.name, "outer"))
    # eigenvalues ascend: the last vector has the largest variance; its sign is made unique below
    ridge = np.linalg.eigh(kept.covariance)[1][:, -1]
    upright = ridge * np.sign(ridge[np.argmax(np.abs(ridge))])
    return _CurrentKnowledge(job, kept, upright, found[:, solved].T, outer_draws)


def refer_to_all_needles(
    known: further_insertion.WeightedPosterior, rng: np.random.Generator
) -> further_insertion.WeightedPosterior:
    """Return a posterior in which b is the mean of all needles, not of those fitted to.

    From that mean a further insertion deviates as any other: the deviations of two of them are independent.
    """
    sd = math.sqrt(max(0.0, known.bevel_sd**2 - 1))  # of the mean of the n fitted to: sqrt(1 / n)
    sets = vary_bevels(known.sets, sd, rng)
    return replace(known, thetas=np.array([known.problem.parameters.theta(values) for values in sets]))


def _run_task(now: GetKnowledge, where: Row, names: tuple[str, ...], predict: PredictInsertion) -> FrameRows:
    """Return what one insertion is expected to tell."""
    before = now()
    if before is None:
        return {}
    insertion = predict(before.known.middle)
    if insertion is None:
        return {"candidates": [{**where, "note": "no solution, or outside the medium"}]}
    problem = replace(before.known.problem, insertions=(insertion,), centred_bevels=False)
    after, gain, failed = _estimate_gain(before, problem, where)
    # the linear gain, its mean over draws; each is taken where its own data would be
    linear, covariance = [], after.known.covariance
    for theta in after.known.thetas[after.outer_draws[:LINEAR_DRAWS]]:
        simulated = with_predicted_shape(after.job, insertion, problem.values(theta))
        if simulated is not None:
            slopes = precision.linearize(replace(problem, insertions=(simulated,)), theta)[1]
            linear.append(linearized_gain(covariance, slopes))
    shape = {
        "layers": "-".join(map(str, insertion.sequence)),
        "boundaries_mm": " ".join(f"{x:.2f}" for x in insertion.boundaries),
        "deflection_mm": insertion.deflection,
    }
    found = {
        "nats": gain.nats,
        "nats_se": gain.nats_se,
        "linear_nats": float(np.mean(linear)) if linear else math.nan,
    }
    worth = {"ess": gain.effective_sample_size, "draws": len(after.known.thetas), "failed_solves": failed}
    note = {"note": ROUGH_NOTE if gain.effective_sample_size < MIN_ESS else ""}
    return {
        "candidates": [{**where, **shape, **found, **worth, **note}],
        **_quantity_rows(after, gain, where, names),
        "alphas": _shape_rows(problem, before.known.middle, where),
    }


def _estimate_gain(
    now: _CurrentKnowledge, problem: Problem, where: Row
) -> tuple[_CurrentKnowledge, ExpectedGain, int]:
    """Return what is known by the draws that can be solved, what the insertion tells, and how many cannot."""
    (evidence,) = problem.density.observations
    sets = now.known.sets
    (white,) = problem.density.whitened_residuals(sets, 1)
    solved = np.asarray(np.isfinite(white).all(axis=(1, 2)), dtype=np.bool_)
    scales = np.array([values.get(NOISE_SCALE, problem.density.scale) for values in sets])
    # in a new one of several specimens a bevel deviates by less than 1 SD (`find_new_bevel_sd`)
    spreads = min(1.0, now.known.bevel_sd) * np.array([values.get(BEVEL_SPREAD, 0.0) for values in sets])
    kept = now.only(solved)
    rng = random_stream(now.job.recipe.seed, now.job.name, *map(str, where.values()))
    numbers = (np.log(kept.known.weights), scales[solved], spreads[solved], white[solved])
    predicted = PredictedData(*numbers, make_group(evidence.nodes))
    return kept, nested_gain(predicted, kept.outer_draws, kept.quantities, rng), int(np.sum(~solved))


def _quantity_rows(
    now: _CurrentKnowledge, gain: ExpectedGain, where: Row, names: tuple[str, ...]
) -> FrameRows:
    weights, quantities, free = now.known.weights, now.quantities, now.known.problem.names
    before = np.sqrt(weights @ (quantities - weights @ quantities) ** 2)
    every = list(zip(before.tolist(), gain.sds.tolist(), gain.quantity_nats.tolist(), strict=True))
    words = ["" for _ in free] + [directions.describe_combination(now.ridge, free)]
    head = ("parameter", "combination", "sd_now", "sd_after", "nats")
    known = zip([*free, LEAST_KNOWN], words, every, strict=False)
    tip_head = ("tip", "sd_now_mm", "sd_after_mm", "nats")
    tips = zip(names, every[len(free) + 1 :], strict=True)
    return {
        "parameters": [{**where, **dict(zip(head, (*about, *sds), strict=True))} for *about, sds in known],
        "tips": [{**where, **dict(zip(tip_head, (name, *sds), strict=True))} for name, sds in tips],
    }


def _shape_rows(problem: Problem, values: Mapping[str, float], where: Row) -> list[Row]:
    """Return what an insertion would leave of the shape parameters that are fixed, if all else were known."""
    rows = []
    for name in find_fixed_shape(problem):
        free = free_shape(problem, name)
        at = free.names.index(name)
        slope = precision.linearize(free, free.parameters.theta(values))[1][:, at]
        before = 12.0 / float(free.upper[at] - free.lower[at]) ** 2
        after = before + float(slope @ slope)
        rows.append({**where, "parameter": name, "sd_now": before**-0.5, "sd_after": after**-0.5})
    return rows


def _conclude(frames: Frames) -> tuple[str, ...]:
    """Add how the two gains agree, and what the figure draws; return why something is not to be trusted."""
    known = frames["candidates"].dropna(subset=["nats", "linear_nats"])
    ranked = known[known["role"] == "candidate"]
    nats, linear_nats = (ranked[name].to_numpy(dtype=np.float64) for name in ("nats", "linear_nats"))
    rank = float(spearmanr(nats, linear_nats).statistic) if len(ranked) > 1 else float("nan")
    best = len(ranked) > 0 and int(np.argmax(nats)) == int(np.argmax(linear_nats))
    excess = float(np.max(linear_nats - nats)) if len(ranked) else float("nan")
    rows = [dict(zip(AGREEMENT_COLUMNS, (len(ranked), rank, excess, best), strict=True))]
    frames["agreement"] = pd.DataFrame(rows, columns=list(AGREEMENT_COLUMNS))
    # gain, and deviation of the first tip asked for, of every insertion that has a solution
    where, tips = list(_WHERE), frames["tips"]
    gains = frames["candidates"][[*where, "nats", "nats_se"]].dropna(subset=["nats"])
    first = tips[tips["tip"] == (tips["tip"].iloc[0] if len(tips) else "")].drop(columns="nats")
    frames["gains"] = gains.merge(first, how="left", on=where)
    return tuple(fault for fault in frames["posterior"]["note"] if fault)


# ---- the report


def find_candidates(result: Run) -> tuple[pd.DataFrame, Row | None, Row | None]:
    """Return the candidates with a solution, the best of them, and the repeat of the deepest insertion."""
    every = result.frames["candidates"]
    solved = every[every["nats"].notna()]
    ranked = solved[solved["role"] == "candidate"].sort_values("nats", ascending=False, kind="stable")
    first = (to_records(rows.head(1)) for rows in (ranked, solved[solved["role"] == "repeat"]))
    best, again = (next(iter(rows), None) for rows in first)
    return ranked, best, again


def _select(result: Run, frame: str, where: Row) -> list[Row]:
    return select_records(result.frames[frame], **{key: where[key] for key in _WHERE})


def describe(result: Run) -> dict[str, Any]:
    """Return what the text prints."""
    _, best, again = find_candidates(result)
    tips, alphas = result.frames["tips"], result.frames["alphas"]
    wanted = tips[tips["role"] == "candidate"].sort_values("sd_after_mm", kind="stable")
    order = {name: place for place, name in enumerate(tips["tip"].unique())}
    worst = (
        next((row for row in _select(result, "parameters", best or {}) if _is_worst(row)), None)
        if best
        else None
    )
    (posterior,) = to_records(result.frames["posterior"]) or ({},)
    return {
        "best": best and {**best, "name": _name_entry(best)},
        "again": again,
        "parameters": [
            # a parameter, or the combination that is known worst, with its deviations in words
            {
                "name": f"worst-determined combination, {insert_symbols(str(row['combination']))},"
                if _is_worst(row)
                else format_bare_symbol(str(row["parameter"])),
                **{key: _describe_sd(row, row[key]) for key in ("sd_now", "sd_after")},
            }
            for row in (_select(result, "parameters", best) if best else ())
        ],
        "worst_now": worst and directions.format_sd(worst["sd_now"], True),
        "tips": sorted(
            ({**row, "name": _name_entry(row)} for row in to_records(wanted.drop_duplicates("tip"))),
            key=lambda row: order[row["tip"]],
        ),
        "alphas": [format_symbol(str(name)) for name in alphas["parameter"].unique()],
        "alpha_sd": f"{100 * (alphas['sd_after'] / alphas['sd_now']).min():.1f}" if len(alphas) else "",
        "agreement": to_records(result.frames["agreement"])[0],
        "bent": BENT_RIDGE_NATS,
        "posterior": posterior,
        "rough": int((result.frames["candidates"]["note"] == ROUGH_NOTE).sum()),
    }


def _describe_sd(row: Row, sd: float) -> str:
    return directions.describe_precision(sd, _is_worst(row) or is_logarithmic(str(row["parameter"])))


def _is_worst(row: Row) -> bool:
    return bool(row["parameter"] == LEAST_KNOWN)


def _name_entry(row: Row) -> str:
    return entry_name(str(row["entry"]), float(row["angle_deg"]))


def tabulate(result: Run) -> list[Table]:
    """Return the best depth of every entry and angle beside a repeat, and the deviations left by the best."""
    ranked, best, again = find_candidates(result)
    if best is None:
        return []
    repeats = [] if again is None else [again]
    shown = [*to_records(ranked.drop_duplicates(["entry", "angle_deg"])), *repeats]
    names = [str(name) for name in result.frames["tips"]["tip"].unique()]
    columns = (
        *("entry", "layers_passed", "candidate_depth_mm", "deflection_mm", "gain", "linear_nats"),
        *("worst_known_sd", *(part("sd_after_mm", tip=name) for name in names)),
    )
    cells = []  # a row per candidate and tip after it
    for number, row in enumerate(shown):
        (worst,) = (one for one in _select(result, "parameters", row) if _is_worst(one))
        about = {
            "entry": "repeat of the deepest" if row["role"] == "repeat" else _name_entry(row),
            "layers_passed": row["layers"],
            "candidate_depth_mm": row["depth_mm"],
            "sd_after": directions.format_sd(worst["sd_after"], True),
            "number": number,
        }
        cells += [
            {**row, **about, "tip": one["tip"], "sd_after_mm": one["sd_after_mm"]}
            for one in _select(result, "tips", row)
        ]
    gains = pivot(cells, ["number"], ["tip"])
    keys = ("known_now", "known_after_best", "known_after_repeat")[: 2 + len(repeats)]
    each = [_select(result, "parameters", one) for one in (best, *repeats)]
    rows = []
    for same in zip(*each, strict=True):
        name = str(same[0]["parameter"])
        label = str(same[0]["combination"]) if _is_worst(same[0]) else directions.short_name(name)
        sds = (same[0]["sd_now"], *(row["sd_after"] for row in same))
        words = (_describe_sd(same[0], sd) for sd in sds)
        rows.append({"known_quantity": insert_symbols(label), **dict(zip(keys, words, strict=True))})
    return [
        Table("next_insertion", gains, columns, strong="first"),
        Table("expected_sds", rows, ("known_quantity", *keys)),
    ]


def draw(result: Run) -> dict[str, Drawing]:
    """Return gain, and remaining standard deviation of the first tip asked for, over the depth."""
    frame = result.frames["gains"].assign(origin=result.origin)
    if frame.empty:
        return {}
    names = list(dict.fromkeys(_name_series(frame)["series"]))
    looks = {
        name: Look(name, SERIES_COLOURS[place % len(SERIES_COLOURS)]) for place, name in enumerate(names)
    }
    looks |= {REPEAT: Look(REPEAT, INK, marker="D", filled=False)} if REPEAT in looks else {}
    panels = [Panel("expected gain (nats)", "nats", "nats", low="nats_low", high="nats_high")]
    for tip in frame["tip"].dropna().unique():
        now = (float(frame["sd_now_mm"].iloc[0]), "now")
        panels.append(Panel(f"SD of the {tip} (mm)", "sd_after_mm", "sd_after_mm", reference=now))
    options = {"x": "depth_mm", "by": "series", "panels": panels, "looks": looks, "columns": len(panels)}
    options["size"] = (7.16, 2.9)
    return {"gains": Drawing("curves", frame, {**options, "x_label": "depth (mm)"}, _name_series)}


def _name_series(gains: pd.DataFrame) -> pd.DataFrame:
    names = [
        entry_name(str(one), float(angle))
        for one, angle in zip(gains["entry"], gains["angle_deg"], strict=True)
    ]
    ends = {"nats_low": gains["nats"] - gains["nats_se"], "nats_high": gains["nats"] + gains["nats_se"]}
    series = pd.Series(names, index=gains.index).where(gains["role"] == "candidate", REPEAT)
    return gains.assign(series=series, **ends)


REPORT = StudyReport(KindText("next_insertion"), describe, tabulate, draw)
