"""The verb: learn from more and more new insertions, in several orders, and score what is held out."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from needlefit.inference.draws import Draws, of_prior
from needlefit.inference.parameters import Parameters
from needlefit.project.records.adaptation import AdaptationRecord
from needlefit.project.streams import stream
from needlefit.validation.folds import Fold
from needlefit.validation.heldout import foretold
from needlefit.validation.inquiries.adaptation.curves import conclude
from needlefit.validation.inquiries.adaptation.task import Task, task_of
from needlefit.validation.inquiries.answer import Answer
from needlefit.validation.inquiries.answered import Plan, answered
from needlefit.validation.inquiries.learned import DRAWS, Learned, learn
from needlefit.validation.inquiries.pieces import Piece, Rows
from needlefit.validation.job import Job, Settings
from needlefit.validation.score import Row, Scorer, model_rival

_WHERE = ("way", "learned_from", "n")
_SCORED = ("depth_mm", "boundaries", "converged", "te_mm", "ipe_mean_mm", "floor_te_mm", "floor_ipe_mean_mm")
_TOLD = ("tip_crps_mm", "shape_crps_mm", "tip_in_50", "tip_in_95", "shape_in_50", "shape_in_95", "certified")

FRAMES: Mapping[str, tuple[str, ...]] = {
    "errors": (*_WHERE, "insertion", *_SCORED, *_TOLD),
    "fits": (*_WHERE, "pareto_k", "sampled", "parameter", "value"),
}
"""`learned_from` names new insertions, joined by +, or "nothing"."""


def ask(name: str, record: AdaptationRecord, settings: Settings) -> Answer:
    """Carry out an adaptation.

    Raises
    ------
    ConfigError, DataError
        If anything the record names is missing or wrong.
    """
    return answered(name, record, settings, plan(task_of(name, record, settings)))


def plan(task: Task) -> Plan:
    """Return the pieces: the old model as it is, and what either way makes of each set of new insertions."""
    pieces: dict[str, Piece] = {"none": partial(_no_update, task)}
    for way in ("inflated", "new"):
        for ids in task.sets:
            if ids or way == "inflated":
                pieces[f"{way}: {_named(ids)}"] = partial(_piece, task, way, ids)
    also = {"orders": [list(order) for order in task.orders]}
    return Plan((task.old, task.new), pieces, FRAMES, partial(conclude, task), also)


def _named(ids: tuple[str, ...]) -> str:
    return "+".join(ids) or "nothing"


@dataclass(frozen=True)
class _Known:
    """What one way knows of a medium: every parameter at its best, draws, and what vouches for these."""

    values: Mapping[str, float]
    draws: Draws
    k: float = math.nan
    sampled: bool = False


def _known(learned: Learned) -> _Known:
    return _Known(learned.fit.values, learned.draws, learned.k, learned.sampled)


def _no_update(task: Task) -> Rows:
    return _rows(task, task.old, ("none", ()), _known(task.before))


def _piece(task: Task, way: str, ids: tuple[str, ...]) -> Rows:
    """Learn from a set of new insertions in one way, and score what is held out."""
    parameters = task.parameters if way == "inflated" else task.new.parameters
    if not ids:
        return _rows(task, task.new, (way, ids), _expected(parameters, task.new))
    fold = Fold(f"{way}: {_named(ids)}", tuple(task.teaching[one] for one in ids), ())
    problem = task.new.problem(fold).with_parameters(parameters)
    return _rows(task, task.new, (way, ids), _known(learn(task.new, problem, (fold.name,), task.settings)))


def _expected(parameters: Parameters, job: Job) -> _Known:
    """Return what is expected before any insertion: the prior's peak, or the middle of the bounds."""
    prior = parameters.prior
    peak = dict(zip(prior.names, prior.mean, strict=True))
    middle = 0.5 * (parameters.lower + parameters.upper)
    theta = [peak.get(name, at) for name, at in zip(parameters.free, middle, strict=True)]
    drawn = of_prior(parameters, DRAWS, stream(job.recipe.seed, job.name, "expected"))
    return _Known(parameters.values(np.array(theta)), Draws(drawn, "importance"))


def _rows(task: Task, job: Job, where: tuple[str, tuple[str, ...]], known: _Known) -> Rows:
    """Score every held-out needle along its planned path, and say how it was foretold."""
    way, ids = where
    head: Row = {"way": way, "learned_from": _named(ids), "n": len(ids)}
    fold = Fold(f"{way}: {_named(ids)}", (), task.held_out)
    rival = model_rival(known.values, job.medium, job.dataset)
    told = {row["insertion"]: row for row in foretold(job, fold, known.draws)}
    errors = []
    for insertion in task.held_out:
        floor = job.floor(insertion)
        scorer = Scorer(job.dataset, job.record.reading, {insertion.id: floor})
        scored = scorer.score({}, insertion, rival)[0][-1]  # the planned path comes last
        row = {**scored, **told.get(insertion.id, {})}
        errors.append({**head, **{name: row.get(name) for name in FRAMES["errors"] if name not in head}})
    about = {**head, "pareto_k": known.k, "sampled": known.sampled}
    fits = [{**about, "parameter": name, "value": value} for name, value in known.values.items()]
    return {"errors": errors, "fits": fits}
