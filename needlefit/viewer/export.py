"""Write a recording as a table, a curve, a figure, or a page."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from needlefit.geometry.frames import Placement
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.session import NeedleState, find_tip_force
from needlefit.planning.recording import Recording, begin_replay, replay
from needlefit.planning.steered_needle import SteeredNeedle
from needlefit.viewer.opening import open_recording
from needlefit.viewer.page_needle import compose_page


@dataclass(frozen=True)
class RecordingOutcome:
    """A recording after its replay, and the needle at its end."""

    recording: Recording
    steering: SteeredNeedle  #: its needle, as it stands at the end
    tip_offset_mm: float  #: greatest distance of the tip from its recorded position, mm; 0: the same bits

    @property
    def title(self) -> str:
        return self.recording.head.scene.title or self.recording.head.target

    @property
    def placement(self) -> Placement | None:
        """The position of a measured needle; None for a scene, which contains its own."""
        placement = self.recording.head.placement
        return None if placement is None else Placement.from_record(placement)

    @property
    def state(self) -> NeedleState:
        return self.steering.now

    @property
    def tip_force(self) -> float:
        """The force on the tip, N, as a page shows it; see `find_tip_force`."""
        steering, scene = self.steering, self.steering.scene
        path = steering.input_path()
        return find_tip_force(scene.needle, self.state.tissue, path, steering.first_cell, scene.rules)

    @property
    def scene(self) -> Scene:
        """The scene with the tissue and the inputs at the end of the recording."""
        return replace(self.steering.scene, tissue=self.state.tissue, steps=(self.state.step,))


def replay_to_end(recording: Recording) -> RecordingOutcome:
    """Replay a recording and return the outcome; errors as of `begin_replay` and `replay`."""
    steering = begin_replay(recording)
    tip_offset_mm = max(replayed.tip_offset_mm for replayed in replay(recording, steering))
    return RecordingOutcome(recording, steering, tip_offset_mm)


def write_table(outcome: RecordingOutcome, path: Path) -> None:
    """Write the needle's shape as a table, .csv."""
    from needlefit.reporting.shape_table import write_shape

    write_shape(outcome.scene, outcome.state, path, outcome.placement)


def write_curve(outcome: RecordingOutcome, path: Path) -> None:
    """Write the needle for 3D Slicer, .mrk.json."""
    from needlefit.reporting.slicer import write_simulated_needle

    placement = outcome.placement or outcome.scene.entry.placement
    write_simulated_needle(placement, [outcome.state.shape], path)


def write_picture(outcome: RecordingOutcome, path: Path) -> None:
    """Draw the needle, .svg, .png or .pdf."""
    from needlefit.reporting.figures.needles import draw_state

    draw_state(outcome.title, outcome.scene, outcome.state, path, outcome.tip_force)


def write_page(outcome: RecordingOutcome, path: Path) -> None:
    """Write the page that replays the recording and lets its reader steer on, .html."""
    path.write_text(compose_page(open_recording(outcome.recording), outcome.recording), "utf-8")


Write = Callable[[RecordingOutcome, Path], None]

#: what writes a file, by the option of `needlefit simulate`
WRITERS: dict[str, Write] = {
    "plot": write_picture,
    "csv": write_table,
    "slicer": write_curve,
    "html": write_page,
}
