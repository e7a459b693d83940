"""Run checkpointed tasks, whose rows belong to the frames of a study."""

import json
from collections.abc import Callable, Iterable, Mapping

from needlefit.project.checkpoint import Checkpoint
from needlefit.studies.job import Settings
from needlefit.studies.score import Row
from needlefit.studies.store import to_json_value

FrameRows = dict[str, list[Row]]  #: rows by the name of the frame that they belong to

#: computes the rows of one task from its arguments alone; its random streams are keyed by them too
AnalysisTask = Callable[[], FrameRows]


def run_tasks(
    tasks: Mapping[str, AnalysisTask],
    label: str,
    settings: Settings,
    checkpoint: Checkpoint,
) -> list[FrameRows]:
    """Return the rows of each task that is done, in the order of the tasks; each has its checkpoint.

    A stop leaves tasks undone; one that it interrupts is discarded, because its rows would be incomplete.
    """
    kept = {key: checkpoint.rows(f"task {key}", ("rows",)) for key in tasks}
    finished: dict[str, FrameRows] = {key: rows[0]["rows"] for key, rows in kept.items() if rows}
    left = [key for key in tasks if key not in finished]
    settings.progress(label, len(finished), len(tasks))
    for n, text in settings.task_pool().run(_compute_rows, [tasks[key] for key in left], settings.stop):
        if settings.stop():
            break
        key, rows = left[n], json.loads(text)
        checkpoint.keep_row(f"task {key}", {"rows": rows})
        finished[key] = rows
        settings.progress(f"{label}: {key}", len(finished), len(tasks))
    return [finished[key] for key in tasks if key in finished]


def _compute_rows(task: AnalysisTask) -> str:
    """Return the rows of a task as JSON: fresh ones are the same as rows read from a checkpoint."""
    return json.dumps(task(), default=to_json_value)


def join_rows(parts: Iterable[FrameRows]) -> FrameRows:
    """Return the rows of several tasks, one after the other."""
    every: FrameRows = {}
    for part in parts:
        for frame, rows in part.items():
            every.setdefault(frame, []).extend(rows)
    return every
