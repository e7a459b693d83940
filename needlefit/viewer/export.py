"""Write a needle, of a scene or at the end of a recording, as a table, curves or a figure."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from needlefit.geometry.frames import Placement
from needlefit.mechanics.control import Step
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.session import NeedleState, find_tip_force
from needlefit.mechanics.shape import NeedleShape

if TYPE_CHECKING:
    from needlefit.planning.recording import Recording


@dataclass(frozen=True)
class SimulationOutcome:
    """A needle at the end of its way."""

    title: str
    scene: Scene  #: its steps are those that `shapes` belong to
    shapes: tuple[NeedleShape, ...]  #: after each step, up to the one that failed; of a recording the last
    path: Sequence[Step]  #: that leads to the needle from first contact on
    first_cell: float  #: depth of the first constraint point, mm
    placement: Placement | None = None  #: of a measured needle; None of a scene, which contains it
    recording: "Recording | None" = None
    tip_offset_mm: float = 0.0  #: greatest distance of the tip from where it was recorded, mm

    @property
    def state(self) -> NeedleState:
        return NeedleState(self.shapes[-1], self.scene.steps[len(self.shapes) - 1], self.scene.tissue)


def replay_to_end(recording: "Recording") -> SimulationOutcome:
    """Replay a recording and return the outcome; errors as of `begin_replay` and `replay`."""
    from needlefit.planning.recording import begin_replay, replay

    steering, head = begin_replay(recording), recording.head
    tip_offset_mm = max(replayed.tip_offset_mm for replayed in replay(recording, steering))
    state = steering.now
    return SimulationOutcome(
        head.scene.title or head.target,
        replace(steering.scene, tissue=state.tissue, steps=(state.step,)),
        (state.shape,),
        steering.input_path(),
        steering.first_cell,
        Placement.from_record(head.placement) if head.placement else None,
        recording,
        tip_offset_mm,
    )


def write_file(outcome: SimulationOutcome, option: str, path: Path) -> bool:
    """Write what an option of `needlefit simulate` asks for; return whether there is a needle to write."""
    scene, state = outcome.scene, outcome.state
    if option == "slicer":
        from needlefit.reporting.slicer import write_simulated_needle

        return write_simulated_needle(outcome.placement or scene.entry.placement, outcome.shapes, path)
    if not state.shape.converged:
        return False
    if option == "csv":
        from needlefit.reporting.shape_table import write_shape

        write_shape(scene, state, path, outcome.placement)
    else:
        from needlefit.reporting.figures.needles import draw_state

        force = find_tip_force(scene.needle, scene.tissue, outcome.path, outcome.first_cell, scene.rules)
        draw_state(outcome.title, scene, state, path, force)
    return True
