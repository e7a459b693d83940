"""Run of a search (starts and fit), and the callbacks that resume, report and stop it."""

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from types import MappingProxyType
from typing import Any

from needlefit.errors import FitError
from needlefit.project.checkpoint import Checkpoint
from needlefit.project.progress import never_stop
from needlefit.project.tasks import THIS_PROCESS, TaskPool
from needlefit.schemas.recipe import ObjectiveName

INTERRUPTED = "interrupted"

MET_BY_PROFILE = "profile"  #: of a start that stands for a better point, which the profiles about the fit met
#: reasons to end after which no further gain is expected
CONVERGED_REASONS = ("tolerance", "bound", "flat", "roundoff")


@dataclass(frozen=True)
class StartPoint:
    """Where one local search begins: its number, theta, and the seed of its random numbers."""

    index: int
    theta: tuple[float, ...]
    seed: int = 1


@dataclass(frozen=True)
class Start:
    """The result of one local search."""

    index: int  #: which of the recipe's starts, from 0
    #: theta0, theta: where it began, and the best point that it evaluated
    theta0: tuple[float, ...]
    theta: tuple[float, ...]
    #: at `theta`: the negative log posterior, or mm of the metric objective; infinite if no evaluation
    #: succeeded
    objective: float
    #: evaluations, failures: what was evaluated, and what of it failed
    evaluations: int
    failures: int
    #: why it ended: "tolerance" at a minimum, and nothing else is a success: "stalled" (a further step would
    #: gain), "flat" (a parameter has no effect), "bound" (a minimum of the box alone), "budget", "roundoff",
    #: "interrupted", "no finite value", "profile" (no search: a better point that a profile met), ...
    stopped: str
    #: the first evaluations that failed, to be simulated again; not all where there are many
    failed: tuple[tuple[float, ...], ...] = ()
    gradients: int = 0  #: evaluations with derivatives among all; one costs about two without
    joined: int | None = None  #: the start that it met on the way, whose end is its own

    @property
    def succeeded(self) -> bool:
        """Whether the search ended at a minimum, as far as can be determined."""
        return self.stopped == "tolerance" and math.isfinite(self.objective)


@dataclass(frozen=True)
class Fit:
    """The best of all local searches, and all of them."""

    theta: tuple[float, ...]
    values: Mapping[str, float]  #: every parameter at `theta` (Pa, mm)
    objective: float  #: the negative log posterior, or mm of the metric objective, at `theta`
    starts: tuple[Start, ...]  #: in the order of their index; one that was interrupted says so
    #: evaluations, failures: over all starts
    evaluations: int
    failures: int
    interrupted: bool  #: whether the search was stopped before all starts had ended
    minimized: ObjectiveName = "posterior"
    gradients: int = 0  #: over all starts

    @property
    def fault(self) -> str:
        """Why the best point may not be a minimum; empty if a search ended at one."""
        if not self.starts or any(start.stopped in CONVERGED_REASONS for start in self.starts):
            return ""
        reasons = ", ".join(sorted({start.stopped for start in self.starts} - {MET_BY_PROFILE}))
        fix = "check bevel sides, units, layers and poses of the data (needlefit explain not-converged)"
        if any(start.stopped == "budget" for start in self.starts):
            fix = "raise `evaluations` in the recipe"
        return f"no start of the search ended at a minimum ({reasons}); {fix}"


@dataclass(frozen=True)
class Callbacks:
    """Callbacks to resume, report and stop a long computation."""

    #: starts already computed, by index; they are not repeated
    finished: Mapping[int, Start] = field(default_factory=lambda: MappingProxyType({}))
    #: called with each start that ends, in the calling thread; an interrupted one is not reported, so a
    #: resumed search repeats it
    report: Callable[[Start], None] = lambda start: None
    stop: Callable[[], bool] = never_stop  #: asked before every evaluation or step, from any thread
    #: called with the steps a sampler has done and all it will do, or the starts whose approach has ended,
    #: and all
    step: Callable[[int, int], None] = lambda done, total: None
    jobs: int = 1  #: threads; the result does not depend on their number
    #: where the starts of a search run, if they take long; nor does it depend on that
    pool: TaskPool = THIS_PROCESS


def read_starts(checkpoint: Checkpoint, search: str) -> dict[int, Start]:
    """Return the finished starts of one search that a checkpoint keeps, by their index."""
    try:
        starts = [start_from_dict(row) for row in checkpoint.rows(search)]
    except FitError:  # rows of something else, however whole
        checkpoint.set_aside(search)
        return {}
    return {start.index: start for start in starts}


def keep_start(checkpoint: Checkpoint, search: str, start: Start) -> None:
    """Store a finished start of one search."""
    checkpoint.keep_row(search, start_to_dict(start))


def start_to_dict(start: Start) -> dict[str, Any]:
    """Return a start as plain JSON values; every float survives exactly, infinity as None."""
    return asdict(start) | {"objective": start.objective if math.isfinite(start.objective) else None}


def start_from_dict(table: Mapping[str, Any]) -> Start:
    """Return the start that `start_to_dict` wrote; FitError if a checkpoint was damaged."""
    try:
        objective, joined = table["objective"], table["joined"]
        return Start(
            index=int(table["index"]),
            theta0=tuple(map(float, table["theta0"])),
            theta=tuple(map(float, table["theta"])),
            objective=math.inf if objective is None else float(objective),
            evaluations=int(table["evaluations"]),
            gradients=int(table["gradients"]),
            failures=int(table["failures"]),
            stopped=str(table["stopped"]),
            failed=tuple(tuple(map(float, theta)) for theta in table["failed"]),
            joined=None if joined is None else int(joined),
        )
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise FitError(
            f"the checkpoint holds a damaged start: {error!r}", fix="run again without --resume"
        ) from None
