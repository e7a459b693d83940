"""A moment of an insertion as a table and a picture, and moments as an animation."""

import io
import json

import numpy as np
import pandas as pd
import pytest
from PIL import Image
from test_viewer_recording import recorded

from needlefit.mechanics.control import Bevel, Controls, Guide, Step
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.scene import Scene, iterate_states
from needlefit.mechanics.tissue import Tissue
from needlefit.planning.recording import read_recording
from needlefit.reporting.figures import animation
from needlefit.reporting.figures.needles import StateFigure
from needlefit.viewer.export import EXPORT_TYPES, export, replay_to_end, write_picture

NEEDLE = Needle(150.0, 1.0e4)
TISSUE = Tissue(np.array([0.2, 33.0]), np.ones(2), np.array([12.0]))
HELD = Controls(1.0, guides=(Guide(-20.0, 0.4), Guide(6.5, 0.1, None, in_tissue=True, name="ring")))


SCENE = Scene(NEEDLE, TISSUE, (Step(20.0, Bevel(0.085), HELD), Step(15.25, Bevel(0.085, -1), HELD)))


# ---- on the way ----


def small(monkeypatch) -> None:
    """Make animations of ten frames at the most, the last two alike."""
    for name, value in (("MAX_FRAMES", 10), ("FINAL_FRAMES", 2), ("DOTS_PER_INCH", 15)):
        monkeypatch.setattr(animation, name, value)


@pytest.mark.sweep
@pytest.mark.parametrize(("seconds", "speed", "lasts"), [(0.3, 1, 0.5), (1200.0, 2000, 0.8), (40.0, 50, 1.0)])
def test_an_animation_keeps_time_or_is_marked(seconds, speed, lasts, tmp_path, monkeypatch) -> None:
    """And the end stays for a while; frames that are alike are kept as one that is shown longer."""
    titles, drawn = [], []

    class Watched(StateFigure):
        def __init__(self, title, *rest):
            titles.append(title)
            super().__init__(title, *rest)

        def paint(self, moment):
            drawn.append(moment)
            super().paint(moment)

    monkeypatch.setattr(animation, "StateFigure", Watched)
    small(monkeypatch)
    moments = [(seconds * gone / 24.75, moment) for gone, moment in iterate_states(SCENE, 12.0)]
    animation.animate("Held", SCENE, moments, seconds, tmp_path / "a.gif")
    assert titles == ["Held" if speed == 1 else f"Held ({speed} times as fast)"]
    assert len(drawn) - 1 <= animation.MAX_FRAMES and drawn[-1] is moments[-1][1]  # the first for the layout
    with Image.open(tmp_path / "a.gif") as film:
        times = [film.seek(n) or film.info["duration"] for n in range(film.n_frames)]
    assert len(times) <= len(moments)
    assert sum(times) == pytest.approx(1e3 * lasts, abs=101)


# ---- of a recording ----


@pytest.mark.sweep
def test_every_export_of_a_recording_is_of_its_last_moment(tmp_path) -> None:
    log = tmp_path / "log.csv"
    last = recorded(log).found[-1]
    written = {kind: export(log, kind) for kind in EXPORT_TYPES}
    table = pd.read_csv(io.BytesIO(written["shape.csv"]))
    # recorded is the deflection of the beam, drawn the y of its tip
    assert table["y_mm"].iloc[-1] == pytest.approx(last[-1], abs=1e-6)
    (curve,) = json.loads(written["shape.mrk.json"])["markups"]
    assert curve["controlPoints"][-1]["position"][1] == pytest.approx(last[-1], abs=1e-6)
    assert written["inputs.csv"] == log.read_bytes()
    done = replay_to_end(read_recording(log))
    for name in ("a.svg", "b.svg"):
        write_picture(done, tmp_path / name)
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes() != b""
