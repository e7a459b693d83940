"""A moment of an insertion as a table and a picture, and moments as an animation."""

import dataclasses
import io
import json
import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from PIL import Image
from test_viewer_recording import recorded

from needlefit.errors import ConfigError
from needlefit.mechanics.control import Bevel, Controls, Guide, Step, TrackedTip
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.scene import Entry, Scene, iterate_states, simulate_scene
from needlefit.mechanics.session import NeedleState
from needlefit.mechanics.shape import compute_positions, map_beam_points
from needlefit.mechanics.simulate import compute_lateral_load, compute_loads
from needlefit.mechanics.tissue import Tissue
from needlefit.reporting.figures import animation, needles
from needlefit.reporting.figures.animation import sample_states
from needlefit.reporting.figures.needles import (
    SceneOverlays,
    StateFigure,
    describe_changes,
    paint_steps,
)
from needlefit.reporting.shape_table import tabulate_shape, write_shape
from needlefit.viewer.export import EXPORT_TYPES, export, replay_to_end, write_picture
from needlefit.viewer.opening import open_target
from needlefit.viewer.recording import RecordedStep, RecordingWriter, make_head, read_recording
from needlefit.viewer.steering import Change, SteeredNeedle

NEEDLE = Needle(150.0, 1.0e4)
TISSUE = Tissue(np.array([0.2, 33.0]), np.ones(2), np.array([12.0]))
HELD = Controls(1.0, guides=(Guide(-20.0, 0.4), Guide(6.5, 0.1, None, in_tissue=True, name="ring")))


def scene(entry: Entry = Entry(), controls: Controls = HELD) -> Scene:
    steps = (Step(20.0, Bevel(0.085), controls), Step(15.25, Bevel(0.085, -1), controls))
    return Scene(NEEDLE, TISSUE, steps, entry=entry)


def end(of: Scene) -> NeedleState:
    return NeedleState(simulate_scene(of)[-1], of.steps[-1], of.tissue)


UP = np.array([0.0, 2.0])
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


def test_the_table_is_read_back(tmp_path) -> None:
    write_shape(scene(), end(scene()), tmp_path / "shape.csv")
    found = pd.read_csv(tmp_path / "shape.csv")
    assert list(found.columns) == [
        "s_mm", "x_mm", "y_mm", "slope", "world_x_mm", "world_y_mm", "load_n_per_mm", "layer",
    ]  # fmt: skip
    np.testing.assert_allclose(found["y_mm"], tabulate_shape(scene(), end(scene()))["y_mm"], atol=1e-7)
    with pytest.raises(ConfigError, match="no such folder"):
        write_shape(scene(), end(scene()), tmp_path / "none" / "shape.csv")


# ---- the picture ----


@pytest.mark.parametrize("entry", [Entry(), TURNED, Entry(0.0, 0.0, -2.3)])
def test_a_picture_shows_all_of_the_needle_in_true_millimetres(entry: Entry) -> None:
    one = scene(entry)
    moment = end(one)
    measured = compute_positions(moment.shape, np.linspace(0.0, 15.0, 9)) + UP
    overlays = SceneOverlays(measured, measured - UP / 4, measured + UP / 4)
    moment_figure = StateFigure("Held", one, [moment], overlays)
    moment_figure.paint(moment)
    assert moment_figure.axes.get_aspect() == 1
    drawn = np.concatenate([line.get_xydata() for line in moment_figure.axes.lines])
    ends = entry.to_world(compute_positions(moment.shape, moment.shape.x[[0, -1]]))
    guides = entry.to_world([[guide.x, guide.y] for guide in HELD.guides])
    for point in (
        *ends,
        *guides,
        *entry.to_world(measured),
        *entry.to_world(map_beam_points(moment.shape, moment.shape.constraints)),
    ):
        assert np.abs(drawn - point).max(axis=1).min() < 1e-9
        assert moment_figure.axes.get_xlim()[0] < point[0] < moment_figure.axes.get_xlim()[1]
        assert moment_figure.axes.get_ylim()[0] < point[1] < moment_figure.axes.get_ylim()[1]


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


def test_the_inserted_part_alone_is_shown_where_nothing_but_the_bevel_steers() -> None:
    plain = scene(controls=Controls())
    for whole, start in ((None, -4.0), (False, -4.0), (True, -140.0)):
        moment_figure = StateFigure("Free", plain, [end(plain)], SceneOverlays(), whole)
        assert moment_figure.axes.get_xlim()[0] == pytest.approx(start, abs=8.0)


# ---- on the way ----


def small(monkeypatch) -> None:
    """Make animations of ten frames at the most, the last two alike."""
    for name, value in (("MAX_FRAMES", 10), ("FINAL_FRAMES", 2), ("DOTS_PER_INCH", 15)):
        monkeypatch.setattr(animation, name, value)


def test_strides_end_where_the_steps_do() -> None:
    one = scene()
    gone, moments = zip(*iterate_states(one), strict=True)
    assert gone[0] == 0 and gone[-1] == pytest.approx(20 + 4.75) and max(np.diff(gone)) <= 0.5 + 1e-12
    np.testing.assert_allclose(moments[-1].shape.u, simulate_scene(one)[-1].u, atol=1e-7)
    assert [moment.step.depth for moment in moments if moment.step in one.steps] == [20.0, 15.25]
    diverging = replace(one, steps=(*one.steps, Step(20.0, Bevel(60.0), Controls(tip=TrackedTip(500.0)))))
    assert list(iterate_states(diverging))[-1][1].step.depth <= 20.0


def test_each_frame_shows_the_last_moment_before_it() -> None:
    moments = [(0.0, "a"), (0.1, "b"), (0.15, "c"), (0.35, "d")]
    assert sample_states(moments, [0.0, 0.1, 0.2, 0.3, 0.4]) == ["a", "b", "c", "c", "d"]


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


def test_an_animation_needs_a_known_ending(tmp_path) -> None:
    moments = list(iterate_states(scene(), 20.0))
    for name, fault in (("a.mp4", "`.mp4`"), ("a", "no ending"), ("none/a.gif", "no such folder")):
        with pytest.raises(ConfigError, match=fault):
            animation.animate("Held", scene(), moments, 1.0, tmp_path / name)


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


def test_a_picture_of_a_measured_insertion_shows_it_and_is_marked_synthetic(tmp_path, monkeypatch) -> None:
    subject = open_target("twin/phantom2-01")
    steering = SteeredNeedle(Scene.from_record(subject.record), subject.first_cell)
    change = Change("depth_mm", None, 20.0)
    steering.apply([change])
    head = make_head(subject.name, subject.first_cell, subject.record)
    RecordingWriter(tmp_path / "log.csv", head).write(
        RecordedStep(1, 0.5, (change,), steering.now.shape.tip_lateral)
    )
    shown = []
    monkeypatch.setattr(needles, "StateFigure", lambda *all_: shown.append(all_) or StateFigure(*all_))
    write_picture(replay_to_end(read_recording(tmp_path / "log.csv")), tmp_path / "picture.svg")
    ((*_, overlays),) = shown
    assert overlays.synthetic
    np.testing.assert_array_equal(overlays.measured, subject.measured.points)


def two_layers(*more: Step, entry: Entry = Entry()) -> Scene:
    needle = Needle.from_tube(150.0, 1.27, 80e3)
    tissue = Tissue(np.array([0.2, 33.0]), np.ones(2), np.array([12.0]))
    return Scene(needle, tissue, (Step(25.0, Bevel(0.085)), *more), entry=entry)


MOVED = Step(40.0, Bevel(0.085, -1), Controls(2.0, guides=(Guide(-10.0, 1.0),)))
PULLED = Step(15.0, Bevel(0.085, -1), Controls(2.0))


@pytest.mark.parametrize("angle", [0.0, 0.5, math.pi / 2, -2.3])
def test_every_panel_shows_its_needle_whole_and_where_it_is_held(angle):
    one = two_layers(MOVED, PULLED, entry=Entry(30.0, -7.0, angle))
    shapes = simulate_scene(one)
    panels = paint_steps("Three steps", one, shapes).axes
    assert len(panels) == 3
    for axes, step, shape in zip(panels, one.steps, shapes, strict=True):
        drawn = np.concatenate([line.get_xydata() for line in axes.lines])
        ends = one.entry.to_world(compute_positions(shape, shape.x[[0, -1]]))
        guides = [one.entry.to_world([[guide.x, guide.y]])[0] for guide in step.controls.guides]
        for point in (*ends, *guides):
            assert np.abs(drawn - point).max(axis=1).min() < 1e-9
            assert axes.get_xlim()[0] < point[0] < axes.get_xlim()[1]
            assert axes.get_ylim()[0] < point[1] < axes.get_ylim()[1]
        assert angle == 0 or axes.get_aspect() == 1  # true angles where the entry is tilted


@pytest.mark.parametrize("angle", [0.0, math.pi / 2])
def test_of_many_steps_an_even_selection_is_shown_and_counted_in_the_title(angle, monkeypatch):
    monkeypatch.setattr(needles, "MAX_PANELS", 4)
    many = (Step(26.0 + 0.1 * n, Bevel(0.085, 1 if n < 30 else -1)) for n in range(60))
    one = two_layers(*many, entry=Entry(angle=angle))
    figure = paint_steps("Many steps", one, simulate_scene(one))
    numbers = [int(axes.get_title("left").split()[1].rstrip(":")) for axes in figure.axes]
    assert numbers == [1, 21, 41, 61]
    assert "4 of 61" in figure.legends[0].get_title().get_text()
    assert ["bevel right" in axes.get_title("left") for axes in figure.axes] == [False, False, True, False]
    few = dataclasses.replace(one, steps=one.steps[:4])
    figure = paint_steps("All", few, simulate_scene(few))
    assert len(figure.axes) == 4 and "of" not in figure.legends[0].get_title().get_text()


def test_the_steps_after_a_failure_are_not_drawn():
    one = two_layers(dataclasses.replace(MOVED, bevel=Bevel(60.0)), PULLED)
    shapes = simulate_scene(one)
    assert [shape.converged for shape in shapes] == [True, False]
    panels = paint_steps("Too much", one, shapes).axes
    assert "over-compressed" in " ".join(text.get_text() for text in panels[1].texts)
    assert panels[1].get_title("right") == "" and panels[1].get_aspect() <= 5
    base = one.entry.to_world([[40.0 - 150.0, 2.0]])[0]  # where the step brought it
    assert any(np.allclose(line.get_xydata()[0], base) for line in panels[1].lines)


def test_a_panel_title_names_the_changes_of_its_step():
    first, second, third = two_layers(MOVED, PULLED).steps
    assert describe_changes(None, first) == ["bevel left"]
    assert describe_changes(first, second) == ["bevel right", "base +2 mm", "guide +1 mm"]
    assert describe_changes(second, third) == ["guide let go"]
    named = dataclasses.replace(third, controls=Controls(2.0, guides=(Guide(-10.0, 1.5, name="ring"),)))
    assert describe_changes(third, named, " in C") == ["ring +1.5 mm in C"]
    assert describe_changes(named, third) == ["ring let go"]
    tracked = dataclasses.replace(third, bevel=Bevel(0.1, -1), controls=Controls(2.0, tip=TrackedTip(-0.5)))
    assert describe_changes(third, tracked) == ["bevel right, b 0.1 mm", "tip tracked at −0.5 mm"]
    assert describe_changes(tracked, dataclasses.replace(tracked, controls=Controls(2.0))) == ["tip let go"]
