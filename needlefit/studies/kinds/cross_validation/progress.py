"""The progress of a study: which phase of which fold goes on, and how much of the whole is done."""

from collections.abc import Callable
from functools import partial

from needlefit.datasets.folds import Fold
from needlefit.project.progress import Progress
from needlefit.studies.job import Job

SEARCH_PHASES = {
    "fitted": "search for the best fit",
    "fitted_metric": "search for the smallest errors",
    "b_alone": "search for b alone",
}
#: steps of progress: of a profile, of all posterior draws and of a prediction; a start of a search has 1
PROFILE_STEPS, DRAW_STEPS, PREDICTION_STEPS = 4, 30, 4


class StudyProgress:
    """Reports the phases of all folds of a study, each as long as it takes in a typical one."""

    def __init__(self, job: Job, progress: Progress) -> None:
        self._name, self._progress = job.name, progress
        self._sizes = {fold.name: _size_phases(job, fold) for fold in job.folds}
        self._done: dict[tuple[str, str], float] = {}  # by fold and phase

    def phase(self, fold: Fold, phase: str) -> Callable[..., None]:
        """Return a callback that takes the number of steps of a phase that are done, and of all."""
        return partial(self.report, fold, phase)

    def report(self, fold: Fold, phase: str, step: float = 0, steps: int = 1) -> None:
        """Report so many steps of a phase of a fold as done."""
        self._done[fold.name, phase] = step / steps
        sizes = [(name, *item) for name, phases in self._sizes.items() for item in phases.items()]
        done = sum(self._done.get((name, task), 0.0) * size for name, task, size in sizes)
        number, count = [*self._sizes].index(fold.name) + 1, len(self._sizes)
        place = f"{self._name}: {fold.name} (fold {number} of {count})" if count > 1 else self._name
        self._progress(f"{place}: {phase}", round(done), sum(size for *_, size in sizes))

    def finish(self, fold: Fold, phase: str) -> None:
        """Report all other phases of a fold as done; `phase` goes on."""
        self._done |= {(fold.name, task): 1.0 for task in self._sizes[fold.name]}
        self.report(fold, phase)


def _size_phases(job: Job, fold: Fold) -> dict[str, int]:
    """Return the steps of each phase of a fold."""
    phases = {SEARCH_PHASES[search]: job.recipe.starts for search in job.searches}
    if len(job.folds) == 1:
        phases["profiles"] = PROFILE_STEPS * len(job.parameters.free)
    return phases | {"posterior draws": DRAW_STEPS, "predictions": PREDICTION_STEPS * len(fold.validate)}
