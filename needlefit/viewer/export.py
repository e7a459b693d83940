"""Export a recording: its last shape, figures, an animation, its inputs, or one HTML file that plays it.

The HTML file asks for nothing from anywhere: modules of the page are embedded as `data:` addresses in an
import map, since a page opened from a file may not import other files. Modules that
talk to the program are replaced.
"""

import base64
import html
import json
import posixpath
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np

from needlefit import __version__
from needlefit.geometry.frames import Placement
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.session import NeedleState
from needlefit.viewer.messages import encode_band, encode_scene, encode_state
from needlefit.viewer.opening import open_recording
from needlefit.viewer.overlays import compute_band
from needlefit.viewer.plans import continue_insertion
from needlefit.viewer.recording import Recording, begin_replay, read_recording, replay
from needlefit.viewer.steering import SteeredNeedle

if TYPE_CHECKING:
    from needlefit.reporting.figures.needles import SceneOverlays

PAGE = Path(__file__).parent / "page"
MAX_SHARED_STATES = 240  #: states of an HTML file; of a longer recording so many, evenly chosen
#: what stands for modules that talk to the program
OFFLINE_MODULES = {
    "steering.js": "export const command = () => null;",
    "slice.js": "export const slice = () => null;",
}
MAIN_MODULE = "share/main.js"
_IMPORT = re.compile(r'(\bfrom|\bimport) "(\.{1,2}/[^"]+)"')
_PREFIX = "needlefit/"


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
    """Write the needle for 3D Slicer, .mrk.json or .ply."""
    from needlefit.studies.slicer import write_scene

    placement = outcome.placement or outcome.scene.entry.placement
    diameter = outcome.recording.head.scene.needle.outer_diameter_mm
    write_scene(placement, [outcome.state.shape], path, diameter)


def write_picture(outcome: RecordingOutcome, path: Path) -> None:
    """Draw the needle with its overlays, .svg, .png or .pdf."""
    from needlefit.reporting.figures.needles import draw_state

    draw_state(outcome.title, outcome.scene, outcome.state, path, _find_overlays(outcome, banded=True))


def write_animation(outcome: RecordingOutcome, path: Path) -> None:
    """Draw the whole recording, .gif or .mp4; without the band, which belongs to one state."""
    from needlefit.reporting.figures.animation import animate

    recording = outcome.recording
    states = ((replayed.time, replayed.state) for replayed in replay(recording))
    lasted = recording.steps[-1].time if recording.steps else 0.0
    animate(outcome.title, outcome.scene, states, lasted, path, _find_overlays(outcome, banded=False))


def write_share(outcome: RecordingOutcome, path: Path) -> None:
    path.write_text(compose_share(outcome.recording), "utf-8")


Write = Callable[[RecordingOutcome, Path], None]

#: what writes a file, by the option of `needlefit simulate`
WRITERS: dict[str, Write] = {
    "plot": write_picture,
    "csv": write_table,
    "slicer": write_curve,
    "animation": write_animation,
    "html": write_share,
}

_EXPORTS: dict[str, tuple[str, Write | None]] = {
    "shape.csv": ("text/csv", write_table),
    "shape.mrk.json": ("application/json", write_curve),
    "animation.gif": ("image/gif", write_animation),
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


def _find_overlays(outcome: RecordingOutcome, banded: bool) -> "SceneOverlays":
    """Return what was shown beside the needle, if it is still there."""
    from needlefit.reporting.figures.needles import SceneOverlays

    viewed_scene = open_recording(outcome.recording)
    points = None if viewed_scene.measured is None else viewed_scene.measured.points
    spread = viewed_scene.spread if banded else None
    found = compute_band(continue_insertion(outcome.steering, spread))
    if found is None:
        return SceneOverlays(points, synthetic=viewed_scene.synthetic)
    low, high = (np.column_stack((found.x, edge)) for edge in (found.low, found.high))
    return SceneOverlays(points, low, high, viewed_scene.synthetic)


def compose_share(recording: Recording) -> str:
    """Return the text of an HTML file that plays a recording offline; errors as of `replay`."""
    viewed_scene = open_recording(recording)
    steering = begin_replay(recording)
    numbers = np.linspace(0, len(recording.steps), min(len(recording.steps) + 1, MAX_SHARED_STATES))
    wanted = set(np.rint(numbers).astype(np.intp).tolist())
    states = []
    for number, replayed in enumerate(replay(recording, steering)):
        if number in wanted:
            band = None
            if viewed_scene.spread is not None:
                found = compute_band(continue_insertion(steering, viewed_scene.spread))
                band = encode_band(steering.number, found)
            states.append([encode_state(viewed_scene, steering) | {"time_s": replayed.time}, band])
    scene = encode_scene(viewed_scene, steering) | {"slice": False}
    data = {"scene": scene, "states": states, "needlefit": __version__}
    parts = {
        "title": html.escape(viewed_scene.title),
        "style": "".join((PAGE / name).read_text("utf-8") for name in ("style.css", "controls.css")),
        "imports": json.dumps({"imports": dict(_embed_modules())}),
        # "<" would end the element where the data hold "</script>"
        "data": json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c"),
    }
    text = (PAGE / "share/share.html").read_text("utf-8")
    return re.sub(r"\{\{(\w+)\}\}", lambda found: parts[found[1]], text)


def _embed_modules() -> Iterator[tuple[str, str]]:
    """Yield the name and the `data:` address of every module that the file needs."""
    waiting, done = [MAIN_MODULE], set[str]()
    while waiting:
        module = waiting.pop()
        if module in done:
            continue
        done.add(module)
        text = OFFLINE_MODULES.get(module) or (PAGE / module).read_text("utf-8")
        for word, given in set(_IMPORT.findall(text)):
            needed = posixpath.normpath(posixpath.join(posixpath.dirname(module), given))
            text = text.replace(f'{word} "{given}"', f'{word} "{_PREFIX}{needed}"')
            waiting.append(needed)
        yield f"{_PREFIX}{module}", f"data:text/javascript;base64,{base64.b64encode(text.encode()).decode()}"
