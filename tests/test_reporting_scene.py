"""Pictures of simulated scenes."""

import dataclasses
import math
import re
from itertools import pairwise

import matplotlib.style
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.image import imread

from needlefit.errors import ConfigError
from needlefit.mechanics.control import Bevel, Controls, Guide, Step, TrackedTip
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.scene import Entry, Scene, simulate_scene
from needlefit.mechanics.shape import compute_positions
from needlefit.mechanics.tissue import Tissue
from needlefit.reporting.figures import needles
from needlefit.reporting.figures.needles import describe_changes, draw_scene, label_layers, paint_steps
from needlefit.reporting.figures.style import RC_PARAMS


def scene(*more: Step, entry: Entry = Entry()) -> Scene:
    needle = Needle.from_tube(150.0, 1.27, 80e3)
    tissue = Tissue(np.array([0.2, 33.0]), np.ones(2), np.array([12.0]))
    return Scene(needle, tissue, (Step(25.0, Bevel(0.085)), *more), entry=entry)


MOVED = Step(40.0, Bevel(0.085, -1), Controls(2.0, guides=(Guide(-10.0, 1.0),)))
PULLED = Step(15.0, Bevel(0.085, -1), Controls(2.0))


@pytest.mark.sweep
@pytest.mark.parametrize("more", [(), (MOVED, PULLED)], ids=["one step", "three steps"])
@pytest.mark.parametrize(("suffix", "begins"), [("pdf", b"%PDF"), ("png", b"\x89PNG"), ("svg", b"<?xml")])
def test_a_scene_is_drawn_by_its_suffix_with_the_same_bytes(tmp_path, suffix, begins, more):
    one = scene(*more)
    shapes = simulate_scene(one)
    for name in ("a", "b"):
        draw_scene("Two layers", one, shapes, tmp_path / f"{name}.{suffix}")
    first, second = ((tmp_path / f"{name}.{suffix}").read_bytes() for name in ("a", "b"))
    assert first == second
    assert first.startswith(begins)


@pytest.mark.parametrize("angle", [0.0, 0.5, math.pi / 2, -2.3])
def test_every_panel_shows_its_needle_whole_and_where_it_is_held(angle):
    one = scene(MOVED, PULLED, entry=Entry(30.0, -7.0, angle))
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
    one = scene(*many, entry=Entry(angle=angle))
    figure = paint_steps("Many steps", one, simulate_scene(one))
    numbers = [int(axes.get_title("left").split()[1].rstrip(":")) for axes in figure.axes]
    assert numbers == [1, 21, 41, 61]
    assert "4 of 61" in figure.legends[0].get_title().get_text()
    assert ["bevel right" in axes.get_title("left") for axes in figure.axes] == [False, False, True, False]
    few = dataclasses.replace(one, steps=one.steps[:4])
    figure = paint_steps("All", few, simulate_scene(few))
    assert len(figure.axes) == 4 and "of" not in figure.legends[0].get_title().get_text()


@pytest.mark.sweep
def test_the_largest_number_of_panels_has_room_for_its_titles(tmp_path):
    one = scene(*(Step(26.0 + 0.1 * n, Bevel(0.085)) for n in range(400)))
    draw_scene("Many steps", one, simulate_scene(one), tmp_path / "a.png")
    height, width = imread(tmp_path / "a.png").shape[:2]
    assert 200 * 2 < width < 200 * 8 and 200 * 0.4 * needles.MAX_PANELS < height < 200 * 15


@pytest.mark.parametrize(("side", "angle"), [(1, 0.0), (-1, 0.3)])
def test_labels_of_layers_stay_in_the_panel_and_clear_of_its_title(side, angle, monkeypatch):
    monkeypatch.setattr(needles, "MAX_PANELS", 8)
    needle = Needle.from_tube(150.0, 1.27, 80e3)
    tissue = Tissue(np.array([0.1, 0.2, 0.3]), np.ones(3), np.array([20.0, 40.0]))
    steps = tuple(Step(6.2 * n, Bevel(0.05, side)) for n in range(1, needles.MAX_PANELS + 6))
    many = Scene(needle, tissue, steps, entry=Entry(5.0, -7.0, angle))
    with matplotlib.style.context(["default", RC_PARAMS]):
        figure = paint_steps("Many steps", many, simulate_scene(many))
        FigureCanvasAgg(figure)
        figure.draw_without_rendering()
        first = figure.axes[0]
        labels = [text.get_window_extent() for text in first.texts]
        above = [one.get_window_extent() for one in (first.title, first._right_title) if one.get_text()]
        assert len(labels) == 3
        for label in labels:
            assert label.y1 <= first.bbox.y1 + 1 and label.y0 >= first.bbox.y0 - 1
            assert not any(label.overlaps(head) for head in above)
        assert not any(a.overlaps(b) for a, b in pairwise(labels))


def test_a_panel_title_names_the_changes_of_its_step():
    first, second, third = scene(MOVED, PULLED).steps
    assert describe_changes(None, first) == ["bevel left"]
    assert describe_changes(first, second) == ["bevel right", "base +2 mm", "guide +1 mm"]
    assert describe_changes(second, third) == ["guide let go"]
    named = dataclasses.replace(third, controls=Controls(2.0, guides=(Guide(-10.0, 1.5, name="ring"),)))
    assert describe_changes(third, named, " in C") == ["ring +1.5 mm in C"]
    assert describe_changes(named, third) == ["ring let go"]
    tracked = dataclasses.replace(third, bevel=Bevel(0.1, -1), controls=Controls(2.0, tip=TrackedTip(-0.5)))
    assert describe_changes(third, tracked) == ["bevel right, b 0.1 mm", "tip tracked at −0.5 mm"]
    assert describe_changes(tracked, dataclasses.replace(tracked, controls=Controls(2.0))) == ["tip let go"]


def test_the_title_names_the_frame_where_it_is_not_the_world():
    for entry, frame in ((Entry(), ""), (Entry(30.0), " in C")):
        one = scene(MOVED, entry=entry)
        panels = paint_steps("Two steps", one, simulate_scene(one)).axes
        assert panels[1].get_title("left").endswith(f"base +2 mm{frame}  ·  guide +1 mm{frame}")
        assert re.fullmatch(rf"tip [+−]\d\.\d\d mm{frame}", panels[1].get_title("right"))


def test_the_layers_of_a_picture_are_all_called_in_the_same_way():
    one = dataclasses.replace(scene(), layer_names=("fat", "muscle"))
    assert label_layers(one, {0: 1.0, 1: 1.0}) == {0: "fat\n200 kPa", 1: "muscle\n33 MPa"}
    assert label_layers(one, {0: 0.5, 1: 0.5}) == {0: "fat", 1: "muscle"}
    assert label_layers(one, {0: 1.0, 1: 0.2}) == {0: "1\n200 kPa", 1: "2"}
    long = dataclasses.replace(one, layer_names=("", "the muscle below the second fascia"))
    assert label_layers(long, {0: 1.0, 1: 1.0})[1].startswith("layer 2")
    assert label_layers(one, {1: 1.0}) == {1: "muscle\n33 MPa"}


@pytest.mark.parametrize("more", [(), (MOVED, PULLED)], ids=["one step", "three steps"])
def test_no_blank_band_stands_above_or_below_a_picture(tmp_path, more):
    one = scene(*more)
    draw_scene("Two layers", one, simulate_scene(one), tmp_path / "a.png")
    rows = np.flatnonzero((imread(tmp_path / "a.png")[..., :3] < 1).any(axis=(1, 2)))
    height = len(imread(tmp_path / "a.png"))
    assert rows[0] < 0.1 * 200 and rows[-1] > height - 0.1 * 200  # pixels, at 200 to the inch


def test_the_steps_after_a_failure_are_not_drawn():
    one = scene(dataclasses.replace(MOVED, bevel=Bevel(60.0)), PULLED)
    shapes = simulate_scene(one)
    assert [shape.converged for shape in shapes] == [True, False]
    panels = paint_steps("Too much", one, shapes).axes
    assert "over-compressed" in " ".join(text.get_text() for text in panels[1].texts)
    assert panels[1].get_title("right") == "" and panels[1].get_aspect() <= 5
    base = one.entry.to_world([[40.0 - 150.0, 2.0]])[0]  # where the step brought it
    assert any(np.allclose(line.get_xydata()[0], base) for line in panels[1].lines)


STEERED = (
    Controls(1.0), Controls(0.0, 0.02), Controls(stage_slope=0.01), Controls(tip=TrackedTip(0.5)),
    Controls(guides=(Guide(-10.0),)),
)  # fmt: skip


@pytest.mark.parametrize("controls", STEERED)
def test_one_step_that_is_steered_shows_its_base_and_guides(controls):
    plain = scene()
    one = dataclasses.replace(plain, steps=(dataclasses.replace(plain.steps[0], controls=controls),))
    (axes,) = paint_steps("Steered", one, simulate_scene(one)).axes
    assert axes.get_title("left").startswith("to 25 mm")
    drawn = np.concatenate([line.get_xydata() for line in axes.lines])
    held = [(25.0 - 150.0, controls.base_y + 25.0 * controls.stage_slope)]
    for point in held + [(guide.x, guide.y) for guide in controls.guides]:
        assert np.abs(drawn - point).max(axis=1).min() < 1e-9


@pytest.mark.parametrize(("controls", "whole"), [(Controls(), False), *((c, True) for c in STEERED)])
def test_only_a_steered_step_is_drawn_whole_and_in_the_world(tmp_path, monkeypatch, controls, whole):
    drawn = []
    monkeypatch.setattr(needles, "draw", lambda path, paint: drawn.append(paint()))
    one = dataclasses.replace(scene(entry=Entry(30.0)), steps=(Step(25.0, Bevel(0.085), controls),))
    draw_scene("One step", one, simulate_scene(one), tmp_path / "one.png")
    (axes,) = drawn[0].axes
    assert (axes.get_xlim()[0] < 30.0 + 25.0 - 150.0) == whole
    assert whole or axes.get_xlim() == pytest.approx((-0.22 * 25.0, 1.04 * 25.0))
    assert ("world" in drawn[0]._supxlabel.get_text()) == whole


@pytest.mark.parametrize("step", [Step(25.0, Bevel(60.0)), Step(0.0, Bevel(0.1))], ids=["failed", "outside"])
def test_a_needle_that_shows_little_is_drawn_all_the_same(tmp_path, step):
    one = dataclasses.replace(scene(), steps=(step,))
    draw_scene("One step", one, simulate_scene(one), tmp_path / "needle.png")
    assert (tmp_path / "needle.png").stat().st_size > 0


@pytest.mark.parametrize("name", ["needle.jpg", "needle"])
def test_another_suffix_is_refused_and_the_valid_ones_named(tmp_path, name):
    one = scene()
    shapes = simulate_scene(one)
    with pytest.raises(ConfigError, match="needle") as fault:
        draw_scene("Two layers", one, shapes, tmp_path / name)
    assert all(suffix in str(fault.value) for suffix in (".pdf", ".png", ".svg"))
    with pytest.raises(ConfigError, match="no such folder"):
        draw_scene("Two layers", one, shapes, tmp_path / "missing" / "needle.pdf")
