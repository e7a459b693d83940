"""Compute one replicate with a synthetic truth: another model than the fitted one, and held-out predictions.

The truth is that of the synthetic dataset (`needlefit.synthetic.truth`): friction, layers that differ between
specimens, muscle whose modulus varies from place to place, a needle stiffer or softer than stated, and errors
of pose and roll. Each replicate draws it anew for the insertions of the study, has them measured and
reconstructed, fits as the study does, and asks where true values and measured tips lie in what was inferred.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from needlefit.datasets.insertion import Dataset
from needlefit.datasets.read import read
from needlefit.errors import ConfigError, ModelError
from needlefit.inference.predict import Draws
from needlefit.project.json_values import to_json_values
from needlefit.project.random_streams import random_stream
from needlefit.studies.held_out_predictions import predict_held_out
from needlefit.studies.job import Inputs, Job, Settings, prepare
from needlefit.studies.kinds.calibration.replicate import (
    InferenceOptions,
    InferredPosterior,
    infer_posterior,
    summarize_inference,
)
from needlefit.studies.new_specimens import NewSpecimens
from needlefit.studies.rank_statistics import RANK_DRAWS, place_pit
from needlefit.studies.score import Row
from needlefit.synthetic.build import build_dataset, build_unscanned
from needlefit.synthetic.design import PlannedInsertion, list_planned_insertions
from needlefit.synthetic.truth import bevel_offset, draw_specimen

HELD_OUT_TIP = "held_out_tip"
"""The quantity of all held-out tips: those of one replicate count as one trial."""

PREDICTION_DRAWS = 13 * (RANK_DRAWS + 1) - 1
"""Draws of each posterior, 1039: among them the truth has 13 places for each place of a rank."""

MAX_TWIN_SEEDS = 20
"""Seeds of a replicate among which one must have a solution."""


@dataclass(frozen=True)
class SyntheticExperiment:
    """The data that all replicates share.

    Attributes
    ----------
    job : Job
        Of one fold, with what it holds out.
    plan : tuple of PlannedInsertion
        Simulated for each replicate: the study's, and those that tell how much its specimens differ.
    ct : bool
        Whether they are rendered as CT volumes and reconstructed.
    """

    job: Job
    plan: tuple[PlannedInsertion, ...]
    ct: bool


def prepare_synthetic(job: Job, ct: bool) -> SyntheticExperiment:
    """Return what is repeated.

    Raises
    ------
    ConfigError
        If the study has several folds, nothing is free, or an insertion is none of the synthetic dataset.
    """
    if len(job.folds) > 1:
        raise ConfigError(
            f"`{job.name}` has {len(job.folds)} folds: a synthetic truth is fitted once",
            expected="a study with [tune] and [[validate]], or a fit",
        )
    if not job.parameters.free:
        raise ConfigError(f"nothing of medium `{job.record.medium}` is free: there is nothing to infer")
    planned = {one.id: one for one in list_planned_insertions()}
    unknown = [one.id for one in job.insertions if one.id not in planned]
    if unknown:
        raise ConfigError(
            f"insertion {unknown[0]} of dataset `{job.dataset.name}` is none of the synthetic dataset",
            expected="a study or fit on the dataset `twin`: others have no synthetic truth",
        )
    (fold,) = job.folds
    new = NewSpecimens(job, fold, job.parameters.expected)
    others = {name for one in fold.validate if new.differs(one) for name in new.list_others(one)}
    wanted = {one.id for one in job.insertions} | {
        one.id for one in job.dataset.insertions if one.specimen in others
    }
    return SyntheticExperiment(job, tuple(one for name, one in planned.items() if name in wanted), ct)


def replicate_synthetic(number: int, experiment: SyntheticExperiment) -> dict[str, Any]:
    """Return one row: ranks of true values and of held-out tips, and their PIT values as nested rows."""
    job, seed, redrawn = _draw_study(number, experiment)
    (fold,) = job.folds
    rng = random_stream(job.recipe.seed, job.name, "inference")
    options = InferenceOptions(job.recipe, PREDICTION_DRAWS)
    found = infer_posterior(job.problem(fold), options, rng)
    parameters = _compare_parameters(job, found, seed)
    new = NewSpecimens(job, fold, found.mode)
    predictions = [one.row for one in predict_held_out(job, fold, _to_draws(found), new)]
    sides = {one.id: one.side for one in fold.validate}
    pits = {one["insertion"]: _orient_pit(one["tip_pit"], sides[one["insertion"]]) for one in predictions}
    return {
        "replicate": number,
        "seed": seed,
        "redrawn": redrawn,
        **summarize_inference(found),
        # what cannot be predicted lies outside every interval
        **{f"rank_{HELD_OUT_TIP}:{name}": place_pit(pits.get(name, 0.0)) for name in sides},
        **{f"rank_{one['parameter']}": place_pit(one["pit"]) for one in parameters},
        "parameters": to_json_values(parameters),
        "predictions": to_json_values(predictions),
    }


def _draw_study(number: int, experiment: SyntheticExperiment) -> tuple[Job, int, int]:
    """Return the study on the data of a replicate, its seed, and how often it was drawn again."""
    job = experiment.job
    for redrawn in range(MAX_TWIN_SEEDS):
        rng = random_stream(job.recipe.seed, job.name, "calibrate", number, "twin", redrawn)
        seed = int(rng.integers(2**31))
        try:
            dataset = _build(seed, experiment)
        except ModelError:  # a needle that does not settle
            continue
        # the name keys the random numbers of predictions, which no two replicates share
        settings = Settings(seed=job.recipe.seed, inputs=Inputs(medium=job.medium, recipe=job.recipe))
        return prepare(f"{job.name} {number}", job.record, settings, dataset), seed, redrawn
    raise ModelError(
        f"of {MAX_TWIN_SEEDS} synthetic datasets none has a solution for every insertion",
        fix="select other insertions",
    )


def _build(seed: int, experiment: SyntheticExperiment) -> Dataset:
    build = build_dataset if experiment.ct else build_unscanned
    with TemporaryDirectory() as folder:
        return read(build(Path(folder), seed, experiment.plan))


def _to_draws(found: InferredPosterior) -> Draws:
    faults = () if found.trusted else ("the posterior is not certified",)
    return Draws(found.thetas, "posterior" if found.draw_source == "sampler" else "importance", faults)


def _orient_pit(pit: float, side: int) -> float:
    """Return the probability predicted of less toward the bevel; stored ones are toward +y."""
    return pit if side > 0 else 1 - pit


def _compare_parameters(job: Job, found: InferredPosterior, seed: int) -> list[Row]:
    """Return a row for each free parameter that has a true value."""
    sets = [job.parameters.values(theta) for theta in found.thetas]
    truths = {name: find_true_value(job, name, seed) for name in job.parameters.free}
    return [_compare_parameter(name, truth, sets) for name, truth in truths.items() if np.isfinite(truth)]


def _compare_parameter(name: str, truth: float, sets: Sequence[Mapping[str, float]]) -> Row:
    values = np.array([one[name] for one in sets])
    low, middle, high = np.percentile(values, [2.5, 50.0, 97.5]).tolist()
    below = int(np.sum(values < truth))
    # the middle of the truth's place among the draws
    pit = (below + 0.5) / (len(values) + 1)
    return {
        **{"parameter": name, "truth": truth, "value": middle},
        **{"interval_low": low, "interval_high": high, "pit": pit},
    }


def find_true_value(job: Job, name: str, seed: int) -> float:
    """Return the geometric mean of a parameter over specimens, layers and bevels that a fit learns from.

    NaN for what the truth has not: hyperparameters, exponents, the angle of a cut.
    """
    planned = {one.id: one for one in list_planned_insertions()}
    tuned = [planned[one.id] for one in job.folds[0].tune]
    specimens = [draw_specimen(seed, one.medium, one.specimen) for one in tuned]
    if name == "bevel_mm":
        known = [bevel_offset(*pair) for pair in zip(specimens, tuned, strict=True)]
        return float(np.exp(np.mean(np.log(known))))
    same = [name, *(tied for tied, (_, source) in job.parameters.ties.items() if source == name)]
    layers = [int(one.removeprefix("mu").removesuffix("_pa")) - 1 for one in same if one.startswith("mu")]
    if not layers:
        return float("nan")
    return float(1e6 * np.exp(np.mean([np.log(specimen.mu[layers]) for specimen in specimens])))
