"""The whole twin: every planned insertion simulated and measured; the dataset, and apart the truth."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from needlefit.datasets.schema import InsertionRow
from needlefit.datasets.write import write_dataset
from needlefit.geometry.surfaces import Surface
from needlefit.synthetic.design import Planned, insertions
from needlefit.synthetic.measure import TURN_SD
from needlefit.synthetic.phantoms import PHANTOMS, surface_file, surfaces
from needlefit.synthetic.statement import BOUNDARY_SD, statement
from needlefit.synthetic.truth import POSE_ANGLE_SD, POSE_SHIFT_SD
from needlefit.synthetic.truth_file import write_truth
from needlefit.synthetic.twin import SEED, Twin, synthesize

Progress = Callable[[str, int, int], None]


def _quiet(_what: str, _done: int, _of: int) -> None:
    """Report nothing."""


def build(folder: Path, seed: int = SEED, progress: Progress = _quiet) -> Path:
    """Write the twin of `seed` into `folder`; return its `dataset.toml`. The same seed gives the same bytes.

    Parameters
    ----------
    progress : callable
        Told what is being done, how many insertions are done, and of how many.
    """
    plan = insertions()
    twins = []
    for done, planned in enumerate(plan):
        progress(planned.id, done, len(plan))
        twins.append(synthesize(planned, seed))
    progress("writing", len(plan), len(plan))
    write_truth(folder / "truth.toml", seed, twins)
    return _write(folder, seed, twins)


def _write(folder: Path, seed: int, twins: Sequence[Twin]) -> Path:
    rows = [_row(twin.planned) for twin in twins]
    centerlines = {twin.planned.id: twin.measured for twin in twins}
    return write_dataset(folder, statement(seed), rows, centerlines, _stated_surfaces())


def _row(planned: Planned) -> InsertionRow:
    """Return what the dataset states of an insertion: the plan; y of C points to +y of the phantom."""
    return InsertionRow(
        id=planned.id,
        medium=planned.medium,
        specimen=planned.specimen,
        layers=planned.layers,
        layers_alternative=planned.layers_alternative,
        depth=planned.depth,
        side=planned.side,
        entry=planned.origin,
        direction=planned.direction,
        bevel=planned.side * planned.toward,
        pose_source="stage",
        pose_shift_sd=POSE_SHIFT_SD,
        # what turns the centreline against the stage: the stage itself, and the registration
        pose_angle_sd=float(np.hypot(np.radians(POSE_ANGLE_SD), TURN_SD)),
        boundary_sd=BOUNDARY_SD if planned.medium != "chicken" else 0.0,
    )


def _stated_surfaces() -> dict[str, Surface]:
    return {
        surface_file(medium, surface): surface
        for medium, phantom in PHANTOMS.items()
        for surface in surfaces(phantom)
    }
