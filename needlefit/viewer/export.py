"""Export a recording: its last shape, figures, an animation, or its inputs."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np

from needlefit.geometry.frames import Placement
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.session import NeedleState
from needlefit.viewer.interaction.steering import SteeredNeedle
from needlefit.viewer.recording import Recording, begin_replay, read_recording, replay

if TYPE_CHECKING:
    from needlefit.reporting.figures.moments import SceneOverlays


@dataclass(frozen=True)
class RecordingOutcome:
    """A recording after its replay, and the needle at its end.

    Attributes
    ----------
    steering : SteeredNeedle
        Its needle, as it stands at the end.
    tip_offset_mm : float
        Greatest distance of the tip from its recorded position, mm; 0: the same bits.
    """

    recording: Recording
    steering: SteeredNeedle
    tip_offset_mm: float

    @property
    def title(self) -> str:
        """The scene's title, or the scene's name if it has no title."""
        return self.recording.head.scene.title or self.recording.head.target

    @property
    def placement(self) -> Placement | None:
        """The position of a measured needle; None for a scene, which contains its own."""
        placement = self.recording.head.placement
        return None if placement is None else Placement.from_record(placement)

    @property
    def state(self) -> NeedleState:
        """The needle's state at the end of the recording."""
        return self.steering.now

    @property
    def scene(self) -> Scene:
        """The scene with the tissue and the inputs at the end of the recording."""
        return replace(self.steering.scene, tissue=self.state.tissue, steps=(self.state.step,))


def replay_to_end(recording: Recording) -> RecordingOutcome:
    """Replay a recording and return the outcome.

    Raises
    ------
    ConfigError, DataError
        As `begin_replay` and `replay`.
    """
    steering = begin_replay(recording)
    tip_offset_mm = max(replayed.tip_offset_mm for replayed in replay(recording, steering))
    return RecordingOutcome(recording, steering, tip_offset_mm)


def list_timed_states(recording: Recording) -> Iterator[tuple[float, NeedleState]]:
    """Yield the time (s) and state of the needle after every step of a recording."""
    return ((replayed.time, replayed.state) for replayed in replay(recording))


def recording_duration(recording: Recording) -> float:
    """Return the duration of a recording, s."""
    return recording.steps[-1].time if recording.steps else 0.0


EXPORT_TYPES = {
    "shape.csv": "text/csv",
    "shape.mrk.json": "application/json",
    "animation.gif": "image/gif",
    "share.html": "text/html",
    "inputs.csv": "text/csv",
}
"""Suffixes of the possible exports, with their media types."""


def export(path: Path, kind: str) -> bytes:
    """Return the content of one of `EXPORT_TYPES` for the recording at `path`, as it is now.

    Raises
    ------
    ConfigError, DataError
        If the recording is damaged.
    """
    if kind == "inputs.csv":
        return path.read_bytes()
    outcome = replay_to_end(read_recording(path))
    with TemporaryDirectory() as folder:
        file = Path(folder) / kind
        _WRITERS[kind](outcome, file)
        return file.read_bytes()


def write_table(outcome: RecordingOutcome, path: Path) -> None:
    """Write the needle's shape as a table, .csv."""
    from needlefit.reporting.shape_table import write_shape

    write_shape(outcome.scene, outcome.state, path, outcome.placement)


def write_curve(outcome: RecordingOutcome, path: Path) -> None:
    """Write the needle for 3D Slicer, .mrk.json or .ply."""
    from needlefit.studies.slicer import write_scene

    placement = outcome.placement or outcome.scene.entry.placement
    diameter = outcome.recording.head.scene.needle.outer_diameter_mm
    write_scene(placement, [outcome.state.shape], path, diameter)


def write_picture(outcome: RecordingOutcome, path: Path) -> None:
    """Draw the needle with its overlays, .svg, .png or .pdf."""
    from needlefit.reporting.figures.moments import draw_moment

    draw_moment(outcome.title, outcome.scene, outcome.state, path, _find_overlays(outcome, banded=True))


def write_animation(outcome: RecordingOutcome, path: Path) -> None:
    """Draw the whole recording, .gif or .mp4; without the band, which belongs to one state."""
    from needlefit.reporting.figures.animation import animate

    states, lasted = list_timed_states(outcome.recording), recording_duration(outcome.recording)
    animate(outcome.title, outcome.scene, states, lasted, path, _find_overlays(outcome, banded=False))


def write_share(outcome: RecordingOutcome, path: Path) -> None:
    """Write the recording as one HTML file that plays it offline."""
    from needlefit.viewer.share import compose_share

    path.write_text(compose_share(outcome.recording), "utf-8")


_WRITERS: dict[str, Callable[[RecordingOutcome, Path], None]] = {
    "shape.csv": write_table,
    "shape.mrk.json": write_curve,
    "animation.gif": write_animation,
    "share.html": write_share,
}


def _find_overlays(outcome: RecordingOutcome, banded: bool) -> "SceneOverlays":
    """Return what was shown beside the needle, if it is still there."""
    from needlefit.reporting.figures.moments import SceneOverlays
    from needlefit.viewer.opening import open_recording
    from needlefit.viewer.overlay.band import compute_band

    viewed_scene, steering, scene = open_recording(outcome.recording), outcome.steering, outcome.scene
    points = None if viewed_scene.measured is None else viewed_scene.measured.points
    found = None
    if banded and viewed_scene.spread is not None:
        found = compute_band(
            viewed_scene.spread,
            scene.needle,
            scene.tissue,
            steering.input_path(),
            scene.rules,
            steering.first_cell,
        )
    if found is None:
        return SceneOverlays(points, synthetic=viewed_scene.synthetic)
    low, high = (np.column_stack((found.x, edge)) for edge in (found.low, found.high))
    return SceneOverlays(points, low, high, viewed_scene.synthetic)
