"""A study in four steps: load what it names, divide it into folds, run each fold, put the results together.

A fit is a study of one fold, which scores only its own insertions. The report judges the run by its tables.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd

from needlefit.datasets.folds import Fold
from needlefit.datasets.insertion import find_free_reach
from needlefit.grouping import group_values
from needlefit.inference.doubts import Doubts
from needlefit.inference.identifiability.stated_direction import predict_factors
from needlefit.inference.parameter_names import BEVEL_PARAMETERS
from needlefit.inference.problem import find_new_bevel_sd
from needlefit.project.callbacks import no_note
from needlefit.project.checkpoint import Checkpoint, open_checkpoint
from needlefit.project.processes import one_thread
from needlefit.project.result_warnings import to_stored_rows
from needlefit.project.tasks import LocalPool, can_fork
from needlefit.reporting.table_files import select_rows
from needlefit.schemas.run_metadata import EffectMetadata, FitMetadata, InsertionMetadata, JobMetadata
from needlefit.schemas.study import FitRecord, StudyRecord
from needlefit.studies.first_page import CONTRADICTIONS, FaultKind, Outcome, RunFault
from needlefit.studies.fit_warnings import list_warnings, tabulate_validity
from needlefit.studies.identity import describe_configuration
from needlefit.studies.job import Job, Settings
from needlefit.studies.judge import judge
from needlefit.studies.kinds.cross_validation.fold import (
    SEARCH_PHASES,
    FitRows,
    FoldResult,
    FoldServices,
    StudyProgress,
    join_rows,
    run_fold,
)
from needlefit.studies.kinds.cross_validation.rows import FRAMES
from needlefit.studies.load import find_odd_needles, join_folds, load_study
from needlefit.studies.prediction_scores import add_errors_over_noise
from needlefit.studies.run import Run

__all__ = ["FRAMES", "Settings", "run"]


@one_thread
def run(name: str, record: FitRecord, settings: Settings) -> Run:
    """Run a study, or a fit, which is a study that scores only its own insertions.

    The same record, data, seed and versions give the same frames for any number of jobs, and after an
    interruption with `resume`.

    Raises ConfigError or DataError if anything the record names is missing or wrong. FitError if a search
    finds no point that can be solved.
    """
    job = load_study(name, record, settings)
    work = describe_configuration(job)
    checkpoint = open_checkpoint(settings.checkpoint, settings.resume, work.work, settings.note)
    services = FoldServices(settings, checkpoint, StudyProgress(job, settings.progress))
    results = run_folds(job, services)
    concluded = conclude_run(job, work, results)
    if not (doubtful := list_doubtful(concluded, job)):
        return concluded
    others = leave_out(job, doubtful)
    if not others.folds:  # all needles are doubtful
        return concluded
    # nothing is printed of the same folds without these needles
    quiet = replace(settings, first=no_note, sample=False)
    progress = StudyProgress(others, settings.progress)
    repeated = run_folds(others, replace(services, settings=quiet, progress=progress))
    if repeated[-1].interrupted:  # what these needles change is not known yet
        return replace(concluded, interrupted=True)
    if repeated[0].mode is None:
        return concluded
    effect = measure_effect(concluded, conclude_run(others, work, repeated), doubtful, job, results, repeated)
    return concluded.with_metadata(effect=effect)


def run_folds(job: Job, services: FoldServices) -> list[FoldResult]:
    """Return the results of the folds, in their order and the same for any number of jobs.

    Where the run is stopped, the last one is interrupted.
    """
    settings = services.settings
    processes = min(settings.jobs, len(job.folds)) if can_fork() else 1
    results_by_number = dict[int, FoldResult]()
    if settings.pool is not None or processes > 1:
        threads = math.ceil(settings.jobs / processes)  # no core is idle
        copied = services.copy(job, jobs=threads, first=no_note, note=no_note)
        folder = services.checkpoint.folder
        # another machine's working folder is another
        copied = replace(copied, checkpoint=Checkpoint(folder and folder.absolute()))
        work = partial(_run_elsewhere, job, copied)
        pool = settings.pool or LocalPool(processes)
        services.progress.report(job.folds[0], SEARCH_PHASES[job.searches[0]])  # until a fold is done
        for number, (result, noted) in pool.run(work, range(len(job.folds)), settings.stop):
            results_by_number[number] = result
            for line in noted:
                services.checkpoint.note(line)
            services.progress.finish(job.folds[number], "errors")
    results: list[FoldResult] = []
    for number, fold in enumerate(job.folds):  # those that were stopped are interrupted here too
        results.append(
            results_by_number[number] if number in results_by_number else run_fold(job, fold, services)
        )
        if results[-1].interrupted:
            break
    return results


def _run_elsewhere(job: Job, services: FoldServices, number: int) -> tuple[FoldResult, list[str]]:
    """Return, in another process, the result of a fold by its number, and the notes about its checkpoint."""
    noted = list[str]()
    checkpoint = replace(services.checkpoint, note=noted.append)
    return run_fold(job, job.folds[number], replace(services, checkpoint=checkpoint)), noted


def conclude_run(job: Job, work: JobMetadata, results: Sequence[FoldResult]) -> Run:
    """Return the run of a job by the results of its folds, with warnings about data, fits and predictions.

    `work` is what `describe_configuration` returns.
    """
    rows = [result.rows for result in results]
    of_folds = {fold.name: result for fold, result in zip(job.folds, results, strict=False)}
    posteriors = {name: result.posterior for name, result in of_folds.items() if result.posterior is not None}
    search_faults = {
        name: list(result.search_faults) for name, result in of_folds.items() if result.search_faults
    }
    frames = add_errors_over_noise({name: _make_frame(job, name, rows) for name in FRAMES})
    needles = frames["needles"]  # of an insertion that several folds hold out, that of the last one
    last = needles.groupby("insertion")["fold"].transform("last")
    frames["needles"] = needles[needles["fold"] == last]
    unconverged = [fault for posterior in posteriors.values() for fault in posterior.faults]
    mode, interrupted, factors = results[0].mode, results[-1].interrupted, dict[str, float]()
    doubts = Doubts() if mode is None or interrupted else find_odd_needles(job, mode)
    if mode is not None and job.dataset.pose == "free" and job.dataset.noise_is_stated:
        factors = predict_factors(join_folds(job), mode)
    where_known = {  # left out where there is nothing to say
        **doubts._asdict(),
        "with_direction": factors,
        **{name: join_rows(rows, name) for name in ("stated_depths", "medians")},
    }
    metadata = work.extend(
        FitMetadata,
        layers={
            insertion.id: list(zip(insertion.sequence, (0.0, *insertion.boundaries.tolist()), strict=True))
            for insertion in job.insertions
        },
        insertions=describe_insertions(job),
        new_bevel_sd={fold.name: _find_bevel_sd(job, fold) for fold in job.folds},
        search_faults=search_faults,
        validity=tabulate_validity([result.counts for result in results], join_rows(rows, "outside")),
        **{name: value for name, value in where_known.items() if value},
    )
    run = Run(
        kind="cross_validation" if isinstance(job.record, StudyRecord) else "fit",
        name=job.name,
        record=job.record,
        origin=job.dataset.origin,
        dataset_title=job.dataset.title or job.dataset.name,
        frames=frames,
        posteriors=posteriors,
        metadata=metadata,
        timing={"dataset": str(job.dataset.path)},
        interrupted=interrupted,
        faults=(
            *find_faults(frames["errors"], search_faults, unconverged),
            *(fault for result in results for fault in result.faults),
        ),
        data=job.dataset.files,
    )
    return run.with_metadata(warnings=to_stored_rows([*job.warnings, *list_warnings(run)]))


def _make_frame(job: Job, name: str, parts: Sequence[FitRows]) -> pd.DataFrame:
    """Return one table of all folds; without rows it still has its columns."""
    rows = join_rows(parts, name)
    values = job.parameters.names if name in ("starts", "profiles", "draws") else ()
    if not rows:
        return pd.DataFrame(columns=[*FRAMES[name], *values])
    if name == "shapes":  # each row holds the columns of one curve
        return pd.concat(map(pd.DataFrame, rows), ignore_index=True)
    return pd.DataFrame(rows)


def find_faults(
    errors: pd.DataFrame, search_faults: Mapping[str, Sequence[str]], not_converged: Sequence[str]
) -> tuple[RunFault, ...]:
    """Return what did not converge: scored simulations of the fit, its search (by fold), posteriors."""
    fitted = select_rows(errors, method="fitted")
    failed = int((~fitted["converged"].astype(bool)).sum())
    faults = [f"{failed} of {len(fitted)} simulations of the fit did not converge"] if failed else []
    folds = group_values((fault, fold) for fold, reasons in search_faults.items() for fault in reasons)
    faults += [
        fault if failing == ["all"] else f"{', '.join(failing)}: {fault}" for fault, failing in folds.items()
    ]
    faults += [f"the posterior has not converged: {why}" for why in not_converged]
    return tuple(RunFault(FaultKind.NOT_CONVERGED, fault) for fault in faults)


def describe_insertions(job: Job) -> dict[str, InsertionMetadata]:
    """Return what a fit knows of every insertion, besides its layers; under a moved guide nothing."""
    drop = job.dataset.drop_proximal if job.dataset.pose == "free" else None
    return {
        insertion.id: InsertionMetadata(
            depth=insertion.depth,
            side=insertion.side,
            bevel_factor=insertion.bevel_factor,
            guide_distance=insertion.guide_distance,
            base_moved=insertion.base_moved,
            compared=None if drop is None else find_free_reach(drop, insertion),
            specimen=insertion.specimen,
            **({"turns": insertion.turns} if insertion.turns else {}),
            **({"needle": insertion.needle.name} if len(job.dataset.needles) > 1 else {}),
            **({"observations": insertion.observations} if len(insertion.observations) > 1 else {}),
        )
        for insertion in job.insertions
        if insertion.guide is None
    }


def _find_bevel_sd(job: Job, fold: Fold) -> float:
    """Return by how many SDs the bevel of a further insertion deviates, see `find_new_bevel_sd`."""
    tuned = {insertion.specimen for insertion in fold.tune}
    new = job.record.specimens == "others" and any(
        insertion.specimen not in tuned for insertion in fold.validate
    )
    return find_new_bevel_sd(job.dataset, fold.tune, new_specimen=new and len(tuned) > 1)


# ---- what a study finds without the needles that are in doubt


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
    # whatever the warnings are: those about a needle stay without it
    judged = [judge(compared_run.with_metadata(warnings=[])) for compared_run in (run, without)]
    outcomes = [Outcome.UNDECIDED if judgement is None else judgement.outcome for judgement in judged]
    values = [job.parameters.values(np.array(fold_results[0].mode)) for fold_results in (results, repeated)]
    names = [name for name in job.parameters.free if name.startswith("mu") or name in BEVEL_PARAMETERS]
    return EffectMetadata(
        insertions=list(left_out),
        outcome=outcomes[1],
        turns=outcomes[0].passed != outcomes[1].passed,
        values={name: tuple(value[name] for value in values) for name in names},
    )
