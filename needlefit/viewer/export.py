"""Export a recording: its last shape, a figure, its inputs, or an HTML file that computes."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np

from needlefit.geometry.frames import Placement
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.session import NeedleState, find_tip_force
from needlefit.planning.recording import Recording, begin_replay, format_head, read_recording, replay
from needlefit.planning.steered_needle import SteeredNeedle
from needlefit.reporting import needle_page
from needlefit.viewer.messages import encode_scene, encode_tables
from needlefit.viewer.opening import open_recording
from needlefit.viewer.overlays import compute_band
from needlefit.viewer.plans import continue_insertion

if TYPE_CHECKING:
    from needlefit.reporting.figures.needles import SceneOverlays

PAGE = Path(__file__).parent / "page"


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
    """Draw the needle with its overlays, .svg, .png or .pdf."""
    from needlefit.reporting.figures.needles import draw_state

    overlays = _find_overlays(outcome)
    draw_state(outcome.title, outcome.scene, outcome.state, path, outcome.tip_force, overlays)


def write_share(outcome: RecordingOutcome, path: Path) -> None:
    path.write_text(compose_share(outcome.recording), "utf-8")


Write = Callable[[RecordingOutcome, Path], None]

#: what writes a file, by the option of `needlefit simulate`
WRITERS: dict[str, Write] = {
    "plot": write_picture,
    "csv": write_table,
    "slicer": write_curve,
    "html": write_share,
}

_EXPORTS: dict[str, tuple[str, Write | None]] = {
    "shape.csv": ("text/csv", write_table),
    "shape.mrk.json": ("application/json", write_curve),
    "picture.svg": ("image/svg+xml", write_picture),
    "picture.pdf": ("application/pdf", write_picture),
    "picture.png": ("image/png", write_picture),
    "share.html": ("text/html", write_share),
    "inputs.csv": ("text/csv", None),
}

#: suffixes of the exports of the page, with their media types
EXPORT_TYPES = {suffix: media_type for suffix, (media_type, _) in _EXPORTS.items()}


def export(path: Path, kind: str) -> bytes:
    """Return the content of one of `EXPORT_TYPES` for the recording at `path`, as it is now.

    ConfigError or DataError if the recording is damaged.
    """
    _, write = _EXPORTS[kind]
    if write is None:
        return path.read_bytes()
    with TemporaryDirectory() as folder:
        file = Path(folder) / kind
        write(replay_to_end(read_recording(path)), file)
        return file.read_bytes()


def _find_overlays(outcome: RecordingOutcome) -> "SceneOverlays":
    """Return what was shown beside the needle, if it is still there."""
    from needlefit.reporting.figures.needles import SceneOverlays

    viewed_scene = open_recording(outcome.recording)
    points = None if viewed_scene.measured is None else viewed_scene.measured.points[:, :2]
    found = compute_band(continue_insertion(outcome.steering, viewed_scene.spread))
    if found is None:
        return SceneOverlays(points, origin_mark=viewed_scene.origin_mark)
    low, high = (np.column_stack((found.x, edge)) for edge in (found.low, found.high))
    return SceneOverlays(points, low, high, viewed_scene.origin_mark)


def compose_share(recording: Recording) -> str:
    """Return the text of an HTML file that replays a recording by itself, and lets its reader steer on.

    ConfigError if the model does not take its scene, or this installation has no kernel in WebAssembly.
    """
    viewed_scene = open_recording(recording)
    steering = begin_replay(recording)
    scene = encode_scene(viewed_scene, steering)
    scene["simulation"]["law"]["tables"] = encode_tables(steering.scene.tissue, recording.steps)
    steps = [
        [step.time, [[one.name, one.item, one.value] for one in step.changes], step.tip_lateral]
        for step in recording.steps
    ]
    data = needle_page.PageData({"needlefit": recording.head.needlefit})
    new_specimen = viewed_scene.specimen == "new"
    head = format_head(recording.head)
    data.needles.append({"scene": scene, "recording": steps, "new_specimen": new_specimen, "head": head})
    return needle_page.compose_file(viewed_scene.title, viewed_scene.note, data)
