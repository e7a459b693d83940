"""Run the folds of a study: side by side in copies of this process where there are several."""

from dataclasses import dataclass, replace

from needlefit.project.progress import no_note, no_progress
from needlefit.project.tasks import LocalPool, can_fork, stop_requested
from needlefit.studies.job import Job
from needlefit.studies.kinds.cross_validation.fold import FoldResult, FoldServices, run_fold
from needlefit.studies.kinds.cross_validation.progress import StudyProgress


def run_folds(job: Job, services: FoldServices) -> list[FoldResult]:
    """Return the results of the folds, in their order and the same for any number of jobs.

    Where the run is stopped, the last one is interrupted.
    """
    settings = services.settings
    processes = min(settings.jobs, len(job.folds)) if can_fork() else 1
    results_by_number = dict[int, FoldResult]()
    if processes > 1:
        quiet = replace(
            settings,
            jobs=settings.jobs // processes,
            progress=no_progress,
            stop=stop_requested,
            first=no_note,
            note=no_note,
        )
        checkpoint = replace(services.checkpoint, note=no_note)
        copied = FoldServices(quiet, checkpoint, StudyProgress(job, no_progress))
        work = _FoldRunner(job, copied)
        for number, (result, noted) in LocalPool(processes).run(work, range(len(job.folds)), settings.stop):
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


@dataclass(frozen=True)
class _FoldRunner:
    """Runs one fold after another in a copy of the process, by their numbers."""

    job: Job
    services: FoldServices

    def __call__(self, number: int) -> tuple[FoldResult, list[str]]:
        """Return the result of a fold, and the notes about its checkpoint."""
        noted = list[str]()
        services = replace(self.services, checkpoint=replace(self.services.checkpoint, note=noted.append))
        return run_fold(self.job, self.job.folds[number], services), noted
