"""Write a recording as one HTML file that plays it offline: its states, the page's own drawing, definitions.

The file asks for nothing from anywhere: modules of the page are embedded as `data:` addresses in an import
map, since a page opened from a file may not import other files. What talks to the program is replaced by
`page/share/`.
"""

import base64
import json
import posixpath
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from needlefit import __version__
from needlefit.viewer.encoding import encode_band, encode_scene, encode_state
from needlefit.viewer.opening import open_recording
from needlefit.viewer.overlay.band import compute_band
from needlefit.viewer.recording import Recording, begin_replay, replay
from needlefit.viewer.viewed_scene import ViewedScene

MAX_SHARED_STATES = 240
"""States of a file; of a longer recording so many, evenly chosen."""

PAGE = Path(__file__).parent / "page"

OFFLINE_MODULES = ("connection.js", "steering.js", "slice.js")
"""Modules that talk to the program: `page/share/` has their namesakes without a program."""

MAIN_MODULE = "share/main.js"

_IMPORT = re.compile(r'(\bfrom|\bimport) "(\.{1,2}/[^"]+)"')
_PREFIX = "needlefit/"


def compose_share(recording: Recording) -> str:
    """Return the text of the file.

    Raises
    ------
    ConfigError, DataError
        As `replay`.
    """
    viewed_scene = open_recording(recording)
    steering = begin_replay(recording)
    numbers = np.linspace(0, len(recording.steps), min(len(recording.steps) + 1, MAX_SHARED_STATES))
    wanted = set(np.rint(numbers).astype(np.intp).tolist())
    states = []
    for number, replayed in enumerate(replay(recording, steering)):
        if number in wanted:
            state = encode_state(viewed_scene, steering) | {"time_s": replayed.time}
            states.append([state, _encode_band(viewed_scene, steering)])
    scene = encode_scene(viewed_scene, steering) | {"slice": False}
    data = {"scene": scene, "states": states, "needlefit": __version__}
    return _fill(
        (PAGE / "share/share.html").read_text("utf-8"),
        {
            "title": _escape(viewed_scene.title),
            "style": (PAGE / "style.css").read_text("utf-8") + (PAGE / "controls.css").read_text("utf-8"),
            "imports": json.dumps({"imports": dict(_embed_modules())}),
            # "<" would end the element where the data hold "</script>"
            "data": json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c"),
        },
    )


def _encode_band(viewed_scene: ViewedScene, steering: Any) -> dict[str, Any] | None:  # noqa: ANN401
    if viewed_scene.spread is None:
        return None
    band = compute_band(
        viewed_scene.spread, steering.scene.needle, steering.now.tissue, steering.input_path(),
        steering.scene.rules, steering.first_cell,
    )  # fmt: skip
    return encode_band(steering.number, band)


def _fill(text: str, parts: dict[str, str]) -> str:
    return re.sub(r"\{\{(\w+)\}\}", lambda found: parts[found[1]], text)


def _escape(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")


def _embed_modules() -> Iterator[tuple[str, str]]:
    """Yield the name and the `data:` address of every module that the file needs."""
    waiting, done = [MAIN_MODULE], set[str]()
    while waiting:
        module = waiting.pop()
        if module in done:
            continue
        done.add(module)
        text = (PAGE / module).read_text("utf-8")
        needed = {found: _resolve(module, found) for _, found in _IMPORT.findall(text)}
        waiting += needed.values()
        text = _IMPORT.sub(lambda found, to=needed: f'{found[1]} "{_PREFIX}{to[found[2]]}"', text)  # type: ignore[misc]
        yield f"{_PREFIX}{module}", f"data:text/javascript;base64,{base64.b64encode(text.encode()).decode()}"


def _resolve(module: str, needed: str) -> str:
    """Return the path of a module below `page/`, given from another one."""
    path = posixpath.normpath(posixpath.join(posixpath.dirname(module), needed))
    return f"share/{path}" if path in OFFLINE_MODULES else path
