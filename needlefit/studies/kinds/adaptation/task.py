"""Define an adaptation: which insertions are old, new and held out, and the orders of the new ones."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import factorial

import numpy as np

from needlefit.datasets.insertion import Insertion
from needlefit.errors import ConfigError
from needlefit.inference.transferred_prior import TransferredPrior
from needlefit.project.random_streams import random_stream
from needlefit.project.toml_lines import renamed_keys
from needlefit.schemas.study import FitRecord
from needlefit.studies.job import Job, Settings, prepare
from needlefit.studies.kinds.adaptation.schema import AdaptationRecord, BetweenMediaRecord, KnownMediumRecord
from needlefit.studies.posterior_fit import PosteriorFit, fit_posterior


@dataclass(frozen=True)
class AdaptationTask:
    """The data that all tasks of an adaptation share.

    Attributes
    ----------
    record : AdaptationRecord
    settings : Settings
    old, new : Job
    held_out : tuple of Insertion
        New ones that are never fitted to.
    training : mapping
        The other new ones, by id.
    orders : tuple of tuple of str
        Orders of their ids, all different.
    """

    record: AdaptationRecord
    settings: Settings
    old: Job
    new: Job
    held_out: tuple[Insertion, ...]
    training: Mapping[str, Insertion]
    orders: tuple[tuple[str, ...], ...]

    @property
    def counts(self) -> tuple[int, ...]:
        """The numbers of insertions fitted to, ascending."""
        given = self.record.counts
        return tuple(range(len(self.training) + 1)) if given is None else tuple(sorted(set(given)))

    @property
    def sets(self) -> tuple[tuple[str, ...], ...]:
        """The different sets of first insertions of the orders; within a set the order does not matter."""
        return tuple(dict.fromkeys(first_sorted(order, n) for n in self.counts for order in self.orders))

    @cached_property
    def old_posterior(self) -> PosteriorFit:
        """The fit and posterior of the old medium; computed once, the same in every process."""
        (fold,) = self.old.folds
        return fit_posterior(self.old, self.old.problem(fold), (fold.name,), self.settings)

    @cached_property
    def transferred(self) -> TransferredPrior:
        """The widened old posterior, as the prior of the new medium's parameters."""
        spread = {name: _between_sd(name, self.record.between_media) for name in self.new.parameters.free}
        fit, thetas = self.old_posterior.fit.values, self.old_posterior.draws.thetas
        return TransferredPrior.from_draws(self.old.parameters, fit, thetas, self.new.parameters, spread)


def first_sorted(order: tuple[str, ...], n: int) -> tuple[str, ...]:
    """Return the first `n` of an order, sorted."""
    return tuple(sorted(order[:n]))


def name_training_set(order: tuple[str, ...], n: int) -> str:
    """Return the name of a training set in the tables: the first `n` ids of an order, joined by +."""
    return "+".join(first_sorted(order, n)) or "nothing"


def make_task(name: str, record: AdaptationRecord, settings: Settings) -> AdaptationTask:
    """Return the adaptation that a record describes.

    Raises
    ------
    ConfigError, DataError
        If anything it names is missing or wrong.
    """
    old = _job(f"{name} old", "old", _fit_record(record, record.old), settings)
    new = _job(f"{name} new", "new", _fit_record(record, record.new), settings)
    there = {insertion.id: insertion for insertion in new.insertions}
    training = {one: insertion for one, insertion in there.items() if one not in record.new.held_out}
    key, fault = _find_fault(record, old, there, len(training))
    if fault:
        raise ConfigError(
            fault,
            where=f"study {name}",
            key=key,
            expected="new insertions, some held out and enough left to learn from",
        )
    held_out = tuple(there[one] for one in record.new.held_out)
    rng = random_stream(new.recipe.seed, name, "orders")
    return AdaptationTask(
        record, settings, old, new, held_out, training, draw_orders(tuple(training), record.orders, rng)
    )


def draw_orders(names: tuple[str, ...], count: int, rng: np.random.Generator) -> tuple[tuple[str, ...], ...]:
    """Draw `count` different orders, or all there are, independently of each other."""
    found: dict[tuple[str, ...], None] = {}
    while len(found) < min(count, factorial(len(names))):
        found[tuple(names[k] for k in rng.permutation(len(names)))] = None
    return tuple(found)


def _job(name: str, side: str, fit: FitRecord, settings: Settings) -> Job:
    """Return the job of one side, "old" or "new", whose table of the study is called so."""
    with renamed_keys({"tune": f"{side}.insertions", "medium": f"{side}.medium"}):
        return prepare(name, fit, settings)


def _fit_record(record: AdaptationRecord, side: KnownMediumRecord) -> FitRecord:
    named = {"dataset": record.dataset, "medium": side.medium, "recipe": record.recipe}
    table = {
        "schema": FitRecord.SCHEMA,
        **named,
        "layer_count_rule": record.layer_count_rule,
        "tune": side.insertions,
    }
    return FitRecord.model_validate(table)


def _find_fault(
    record: AdaptationRecord, old: Job, there: Mapping[str, Insertion], left: int
) -> tuple[str, str]:
    """Return which key of a record cannot be, and why; two empty texts if all can."""
    unknown = [one for one in record.new.held_out if one not in there]
    if unknown:
        return "new.held_out", f"held_out names {', '.join(unknown)}, which [new] does not select"
    both = sorted(there.keys() & {insertion.id for insertion in old.insertions})
    if both:
        return "new.insertions", f"{', '.join(both)} would be both old and new"
    most = max(record.counts or (1,))
    if most > left:
        return "counts", f"{left} new insertions are left to learn from, of {most} asked for"
    if old.recipe.minimize != "posterior":
        return "recipe", "a fit by errors alone has no posterior to carry over"
    return "", ""


def _between_sd(parameter: str, between: BetweenMediaRecord) -> float:
    kinds = {"mu": between.ln_mu_sd, "alpha": between.alpha_sd, "bevel": between.ln_bevel_sd}
    kinds["cut_angle"] = between.ln_bevel_sd
    return next((sd for kind, sd in kinds.items() if parameter.startswith(kind)), 0.0)
