"""Which insertion to make next: candidates ranked by what they are expected to tell, beside a repeat.

What a candidate tells is the mutual information of parameters and its data, by nested Monte Carlo over the
posterior of what is known already (`inference.identifiability.gain`); its linear form stands beside it.
Errors of pose, depths and points are those of the insertion that the study names as a model of a new one.
All candidates foretell data for the same draws: their differences are better known than their values.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import spearmanr

from needlefit.datasets.insertion import Insertion
from needlefit.errors import FitError
from needlefit.inference.identifiability.freed import fixed_alphas, freed
from needlefit.inference.identifiability.gain import Foreseen, Gain, linear, nested
from needlefit.inference.identifiability.identify import told_by
from needlefit.inference.identifiability.information import combination
from needlefit.inference.problem import Problem
from needlefit.inference.ties import NOISE_SCALE
from needlefit.project.records.next_insertion import NextInsertionRecord, QuantityRecord
from needlefit.project.streams import stream
from needlefit.validation.design import planned
from needlefit.validation.folds import Fold
from needlefit.validation.inquiries.answer import Answer
from needlefit.validation.inquiries.answered import Frames, Plan, answered
from needlefit.validation.inquiries.pieces import Piece, Rows
from needlefit.validation.inquiries.planning.candidates import (
    Place,
    candidate,
    check_reach,
    places,
    seen,
    template,
)
from needlefit.validation.inquiries.planning.knowledge import Knowledge, about, knowledge, tips
from needlefit.validation.job import Job, Settings, prepare
from needlefit.validation.score import Row

Floats = NDArray[np.float64]

OUTER = 400
"""Draws whose data are foretold; their scatter is the standard error of a gain."""

LINEAR = 24
"""Draws at which the linear gain is taken; it is their mean."""

FEW, ROUGH = 10.0, "rough"
"""Draws on which a posterior must stand in the median; what is told by fewer is marked."""

LEAST_KNOWN = "least_known"
"""The combination of parameters that is known worst."""

_WHERE = ("role", "entry", "angle_deg", "depth_mm")
FRAMES: Mapping[str, tuple[str, ...]] = {
    "candidates": (
        *_WHERE,
        *("layers", "boundaries_mm", "tip_mm", "nats", "nats_se", "linear_nats"),
        *("worth", "draws", "failed_solves", "note"),
    ),
    "parameters": (*_WHERE, "parameter", "combination", "sd_now", "sd_after", "nats"),
    "tips": (*_WHERE, "tip", "sd_now_mm", "sd_after_mm", "nats"),
    "alphas": (*_WHERE, "parameter", "sd_before", "sd_after"),
    "posterior": ("insertions", "pareto_k", "sampled", "draws", "independent", "fault"),
}
"""`role` is "candidate", or "repeat": the deepest insertion made so far, once more. Deviations of parameters
are of logarithms, of alpha itself; those of `alphas` are what would be left if all else were known. `worth`
is on how many draws the posterior afterwards stands."""

AGREEMENT = ("candidates", "spearman", "largest_excess_nats", "same_best")
"""How the linear gain agrees with the nested one over the candidates."""


@dataclass(frozen=True)
class _Now:
    """What is known before the next insertion.

    Attributes
    ----------
    job : Job
    known : Knowledge
    ridge : (P,) array
        The unit combination of theta that is known worst.
    tips : (B, T) array
        Deflections of the tips asked for, mm.
    of : (O,) array
        Draws whose data are foretold.
    """

    job: Job
    known: Knowledge
    ridge: Floats
    tips: Floats
    of: NDArray[np.intp]

    @property
    def quantities(self) -> Floats:
        """Parameters, the combination known worst, tips: (B, P + 1 + T)."""
        thetas = self.known.thetas
        return np.column_stack([thetas, thetas @ self.ridge, self.tips])

    def only(self, kept: NDArray[np.bool_]) -> "_Now":
        """Return the same of the draws of a mask (B,) alone."""
        places = np.cumsum(kept) - 1
        of = places[self.of[kept[self.of]]]
        return replace(self, known=self.known.only(kept), tips=self.tips[kept], of=of)


Ask = Callable[[], _Now | None]
Foretell = Callable[[_Now], Insertion | None]
"""What is known now -> an insertion with the shape that is foretold of it; None where there is none."""


def ask(name: str, record: NextInsertionRecord, settings: Settings) -> Answer:
    """Rank the candidates of a study.

    Raises
    ------
    ConfigError, DataError
        If anything the record names is missing or wrong.
    FitError
        If the fit, or an insertion whose tip is asked for, has no solution.
    """
    job = prepare(name, record.tuning(), settings)
    like = template(job, record.like)
    check_reach(job, like, _deepest(record))
    now = cache(partial(_now, job, record, like, settings))
    names = tuple(one.name for one in record.quantities)
    pieces: dict[str, Piece] = {"posterior": partial(_posterior, now)}
    for place in places(record):
        entry, angle, depth = place
        where = dict(zip(_WHERE, ("candidate", entry.name, angle, depth), strict=True))
        key = f"{entry.name}, {angle:g} degrees, {depth:g} mm"
        pieces[key] = partial(_piece, now, where, names, partial(_candidate, like, place))
    deepest = max(job.folds[0].tune, key=lambda one: one.depth)
    where = dict(zip(_WHERE, ("repeat", deepest.id, 0.0, deepest.depth), strict=True))
    pieces["repeat"] = partial(_piece, now, where, names, partial(_repeat, deepest))
    return answered(name, record, settings, Plan([job], pieces, FRAMES, _conclude))


def _deepest(record: NextInsertionRecord) -> dict[str, float]:
    """Return the largest depth that each key of the record holds, mm."""
    entries = {f"entries.{n}.depths_mm": one.depths_mm for n, one in enumerate(record.entries, start=1)}
    wanted = {f"quantities.{n}.depth_mm": (one.depth_mm,) for n, one in enumerate(record.quantities, start=1)}
    every = {"depths_mm": record.depths_mm, **entries, **wanted}
    return {key: max(depths) for key, depths in every.items() if depths}


def _now(job: Job, record: NextInsertionRecord, like: Insertion, settings: Settings) -> _Now | None:
    known = knowledge(job, settings)
    if known is None:
        return None
    wanted = [_target(known, job, like, record, one) for one in record.quantities]
    found = np.array([tips(known, insertion) for insertion in wanted]).reshape(len(wanted), len(known.thetas))
    solved = np.isfinite(found).all(axis=0)
    kept = known.only(solved)
    of = kept.drawn(OUTER, stream(job.recipe.seed, job.name, "outer"))
    ridge = np.linalg.eigh(kept.covariance)[1][:, -1]
    upright = ridge * np.sign(ridge[np.argmax(np.abs(ridge))])
    return _Now(job, kept, upright, found[:, solved].T, of)


def _target(
    known: Knowledge, job: Job, like: Insertion, record: NextInsertionRecord, wanted: QuantityRecord
) -> Insertion:
    """Return the insertion whose tip is asked for."""
    entry = next(entry for entry in record.entries if entry.name == wanted.entry)
    found = candidate(job, like, (entry, wanted.angle_deg, wanted.depth_mm), known.middle)
    if found is None:
        raise FitError(f"the insertion of `{wanted.name}` has no solution, or leaves the medium")
    return found


def _posterior(now: Ask) -> Rows:
    before = now()
    return {} if before is None else {"posterior": [about(before.known)]}


def _candidate(like: Insertion, place: Place, now: _Now) -> Insertion | None:
    return candidate(now.job, like, place, now.known.middle)


def _repeat(made: Insertion, now: _Now) -> Insertion | None:
    """Return an insertion as it would go once more."""
    again = planned(now.job, Fold("again", (made,), ()), now.known.middle)
    return None if again is None else seen(now.job, replace(again.insertions[0], sd=None), now.known.middle)


def _piece(now: Ask, where: Row, names: tuple[str, ...], foretell: Foretell) -> Rows:
    """Return what one insertion is expected to tell."""
    before = now()
    if before is None:
        return {}
    insertion = foretell(before)
    if insertion is None:
        return {"candidates": [{**where, "note": "no solution, or outside the medium"}]}
    problem = replace(before.known.problem, insertions=(insertion,))
    after, gain, failed = _gain(before, problem, where)
    shape = {
        "layers": "-".join(map(str, insertion.sequence)),
        "boundaries_mm": " ".join(f"{x:.2f}" for x in insertion.boundaries),
        "tip_mm": float(insertion.planar[-1, 1]),
    }
    found = {"nats": gain.nats, "nats_se": gain.nats_se, "linear_nats": _linear(after, problem)}
    worth = {"worth": gain.worth, "draws": len(after.known.thetas), "failed_solves": failed}
    note = {"note": ROUGH if gain.worth < FEW else ""}
    return {
        "candidates": [{**where, **shape, **found, **worth, **note}],
        **_quantities(after, gain, where, names),
        "alphas": _alphas(problem, before.known.middle, where),
    }


def _gain(now: _Now, problem: Problem, where: Row) -> tuple[_Now, Gain, int]:
    """Return what is known by the draws that can be solved, what the insertion tells, and how many cannot."""
    (evidence,) = problem.density.evidence
    sets = now.known.sets
    (white,) = problem.density.whites(sets, 1)
    solved = np.asarray(np.isfinite(white).all(axis=(1, 2)), dtype=np.bool_)
    scales = np.array([values.get(NOISE_SCALE, problem.density.scale) for values in sets])
    kept = now.only(solved)
    rng = stream(now.job.recipe.seed, now.job.name, *map(str, where.values()))
    foreseen = Foreseen(np.log(kept.known.weights), scales[solved], white[solved], evidence.nodes)
    return kept, nested(foreseen, kept.of, kept.quantities, rng), int(np.sum(~solved))


def _linear(now: _Now, problem: Problem) -> float:
    """Return the linear gain, its mean over draws; each is taken where its own data would be."""
    gains, covariance = [], now.known.covariance
    for theta in now.known.thetas[now.of[:LINEAR]]:
        made = seen(now.job, problem.insertions[0], problem.values(theta))
        if made is not None:
            gains.append(linear(covariance, told_by(replace(problem, insertions=(made,)), theta)[1]))
    return float(np.mean(gains)) if gains else float("nan")


def _quantities(now: _Now, gain: Gain, where: Row, names: tuple[str, ...]) -> Rows:
    weights, quantities, free = now.known.weights, now.quantities, now.known.problem.names
    before = np.sqrt(weights @ (quantities - weights @ quantities) ** 2)
    every = list(zip(before.tolist(), gain.sds.tolist(), gain.quantity_nats.tolist(), strict=True))
    words = ["" for _ in free] + [combination(now.ridge, free)]
    head = ("parameter", "combination", "sd_now", "sd_after", "nats")
    known = zip([*free, LEAST_KNOWN], words, every, strict=False)
    told = [{**where, **dict(zip(head, (name, said, *three), strict=True))} for name, said, three in known]
    tip_head = ("tip", "sd_now_mm", "sd_after_mm", "nats")
    pairs = zip(names, every[len(free) + 1 :], strict=True)
    return {
        "parameters": told,
        "tips": [{**where, **dict(zip(tip_head, (name, *three), strict=True))} for name, three in pairs],
    }


def _alphas(problem: Problem, values: Mapping[str, float], where: Row) -> list[Row]:
    """Return what an insertion would leave of the alphas that are fixed, if all else were known."""
    rows = []
    for name in fixed_alphas(problem):
        free = freed(problem, name)
        at = free.names.index(name)
        slope = told_by(free, free.parameters.theta(values))[1][:, at]
        before = 12.0 / float(free.upper[at] - free.lower[at]) ** 2
        after = before + float(slope @ slope)
        rows.append({**where, "parameter": name, "sd_before": before**-0.5, "sd_after": after**-0.5})
    return rows


def _conclude(frames: Frames) -> tuple[str, ...]:
    """Add how the two gains agree, and what the figure draws; return why something is not to be trusted."""
    known = frames["candidates"].dropna(subset=["nats", "linear_nats"])
    ranked = known[known["role"] == "candidate"]
    nats, linear_nats = (ranked[name].to_numpy(dtype=np.float64) for name in ("nats", "linear_nats"))
    rank = float(spearmanr(nats, linear_nats).statistic) if len(ranked) > 1 else float("nan")
    best = len(ranked) > 0 and int(np.argmax(nats)) == int(np.argmax(linear_nats))
    excess = float(np.max(linear_nats - nats)) if len(ranked) else float("nan")
    rows = [dict(zip(AGREEMENT, (len(ranked), rank, excess, best), strict=True))]
    frames["agreement"] = pd.DataFrame(rows, columns=list(AGREEMENT))
    frames["told"] = _told(frames)
    return tuple(fault for fault in frames["posterior"]["fault"] if fault)


def _told(frames: Frames) -> pd.DataFrame:
    """Return gain, and deviation of the first tip asked for, of every insertion that has a solution."""
    where, tips = list(_WHERE), frames["tips"]
    gains = frames["candidates"][[*where, "nats", "nats_se"]].dropna(subset=["nats"])
    first = tips[tips["tip"] == (tips["tip"].iloc[0] if len(tips) else "")].drop(columns="nats")
    return gains.merge(first, how="left", on=where)
