"""Problems of insertions that no study selects."""

from collections.abc import Sequence

from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.inference.likelihood.observation import PLAIN_LIKELIHOOD
from needlefit.inference.parameters import Parameters, with_hyperparameters
from needlefit.inference.problem import Problem
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.recipe import LikelihoodRecord, WeightsRecord


def make_problem(
    dataset: Dataset,
    insertions: Sequence[Insertion],
    medium: MediumRecord,
    weights: WeightsRecord,
    likelihood: LikelihoodRecord = PLAIN_LIKELIHOOD,
) -> Problem:
    """Return the problem of fitting `medium` to `insertions`; what the medium frees is searched."""
    parameters = with_hyperparameters(Parameters.from_record(medium), likelihood)
    return Problem(dataset, tuple(insertions), medium, parameters, weights, likelihood=likelihood)
