"""What a study finds without the needles that are in doubt."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from needlefit.datasets.folds import Fold
from needlefit.inference.parameter_names import BEVEL_PARAMETERS
from needlefit.schemas.run_metadata import EffectMetadata, FitMetadata
from needlefit.studies.advice import CONTRADICTIONS
from needlefit.studies.answer import Outcome
from needlefit.studies.job import Job
from needlefit.studies.judge import judge
from needlefit.studies.kinds.cross_validation.fold import FoldResult
from needlefit.studies.run import Run


def list_doubtful(run: Run, job: Job) -> list[str]:
    """Return the needles that contradict their own statements, and those that the others do not predict."""
    named = [
        name for warning in run.warnings if warning.kind in CONTRADICTIONS for name in warning.insertions
    ]
    named += [odd_needle.insertion for odd_needle in run.knows(FitMetadata).odd_needles]
    present = {insertion.id for insertion in job.insertions}
    return [name for name in dict.fromkeys(named) if name in present]


def leave_out(job: Job, names: Sequence[str]) -> Job:
    """Return the work of a study without some needles; folds that are left with nothing to predict go."""
    folds = []
    for fold in job.folds:
        tune, held_out = (
            tuple(insertion for insertion in part if insertion.id not in names)
            for part in (fold.tune, fold.validate)
        )
        if tune and (held_out or not fold.validate):
            folds.append(Fold(f"{fold.name} without {', '.join(names)}", tune, held_out))
    return replace(job, folds=tuple(folds))


def measure_effect(
    run: Run,
    without: Run,
    left_out: Sequence[str],
    job: Job,
    results: Sequence[FoldResult],
    repeated: Sequence[FoldResult],
) -> EffectMetadata:
    """Return what the needles left out change: the outcome, and the parameters of the first fit."""
    outcomes = [_find_outcome(compared_run) for compared_run in (run, without)]
    values = [job.parameters.values(np.array(fold_results[0].mode)) for fold_results in (results, repeated)]
    names = [name for name in job.parameters.free if name.startswith("mu") or name in BEVEL_PARAMETERS]
    return EffectMetadata(
        insertions=list(left_out),
        outcome=outcomes[1],
        turns=outcomes[0].passed != outcomes[1].passed,
        values={name: tuple(value[name] for value in values) for name in names},
    )


def _find_outcome(run: Run) -> Outcome:
    """Return the outcome whatever the warnings are: those about a needle stay without it."""
    judged = judge(run.with_metadata(warnings=[]))
    return Outcome.UNDECIDED if judged is None else judged.outcome
