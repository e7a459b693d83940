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
from needlefit.mechanics.scene import Entry, Scene, iterate_states, simulate_scene
from needlefit.mechanics.session import NeedleState
from needlefit.mechanics.shape import compute_positions
from needlefit.mechanics.simulate import compute_lateral_load, compute_loads
from needlefit.mechanics.tissue import Tissue
from needlefit.reporting.figures import animation
from needlefit.reporting.figures.needles import (
    StateFigure,
)
from needlefit.reporting.shape_table import tabulate_shape
from needlefit.viewer.export import EXPORT_TYPES, export, replay_to_end, write_picture
from needlefit.viewer.recording import read_recording

NEEDLE = Needle(150.0, 1.0e4)
TISSUE = Tissue(np.array([0.2, 33.0]), np.ones(2), np.array([12.0]))
HELD = Controls(1.0, guides=(Guide(-20.0, 0.4), Guide(6.5, 0.1, None, in_tissue=True, name="ring")))


def scene(entry: Entry = Entry(), controls: Controls = HELD) -> Scene:
    steps = (Step(20.0, Bevel(0.085), controls), Step(15.25, Bevel(0.085, -1), controls))
    return Scene(NEEDLE, TISSUE, steps, entry=entry)


def end(of: Scene) -> NeedleState:
    return NeedleState(simulate_scene(of)[-1], of.steps[-1], of.tissue)


TURNED = Entry(30.0, -7.0, 0.5)


# ---- the table ----


@pytest.mark.sweep
def test_the_table_has_a_row_for_every_node_and_millimetre() -> None:
    one = scene(TURNED)
    moment = end(one)
    table = tabulate_shape(one, moment)
    s = table["s_mm"].to_numpy()
    assert (s[0], s[-1]) == (15.25 - 150, 15.25) and (np.diff(s) > 1e-6).all()
    assert np.isin(moment.shape.x, s).all() and np.diff(s).max() <= 1.0
    nodes = table[np.isin(s, moment.shape.x)]
    np.testing.assert_array_equal(nodes["y_mm"], compute_positions(moment.shape, moment.shape.x)[:, 1])
    np.testing.assert_allclose(nodes["slope"], moment.shape.slope, atol=1e-12)
    place = compute_positions(moment.shape, s)
    np.testing.assert_array_equal(table[["x_mm", "y_mm"]], place)
    np.testing.assert_array_equal(table[["world_x_mm", "world_y_mm"]], TURNED.to_world(place))
    np.testing.assert_array_equal(table["load_n_per_mm"], compute_lateral_load(moment.shape, TISSUE, s))
    assert table["layer"].isna().sum() == (s < 0).sum()
    assert (table["layer"][s >= 0] == np.where(s[s >= 0] <= 12.0, 1, 2)).all()


# ---- the picture ----


def test_loads_are_drawn_to_the_scale_that_the_legend_states() -> None:
    one = scene()
    moment = end(one)
    moment_figure = StateFigure("Held", one, [moment])
    moment_figure.paint(moment)
    found = compute_loads(moment.shape, TISSUE, NEEDLE, moment.step.controls)
    outlines = [patch.get_xy() for patch in moment_figure.axes.patches]
    needle = compute_positions(moment.shape, found.s)
    (load,) = (outline for outline in outlines if len(outline) == 2 * len(found.s) + 1)  # closed
    pulled = load[len(found.s) : -1][::-1] - needle
    np.testing.assert_allclose(pulled[:, 1] * moment_figure.per_mm, found.load, atol=1e-9)
    (legend,) = moment_figure.figure.legends
    labels = [text.get_text() for text in legend.get_texts()]
    assert any(f" {moment_figure.per_mm:g} N/mm " in label for label in labels)
    arrow = np.array(moment_figure.axes.texts[-1].xy) - moment_figure.axes.texts[-1].xyann
    assert arrow[1] == pytest.approx(found.tip_force * moment_figure.arrow)


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
    moments = [(seconds * gone / 24.75, moment) for gone, moment in iterate_states(scene(), 12.0)]
    animation.animate("Held", scene(), moments, seconds, tmp_path / "a.gif")
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
