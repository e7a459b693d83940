"""A needle in somebody's hand, its recording, and the recording carried out again."""

import csv
from collections import defaultdict

import numpy as np
import pytest

from needlefit.errors import NeedlefitError
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.shape import compute_positions
from needlefit.planning.steered_needle import (
    Change,
    RecordedStep,
    Recording,
    SteeredNeedle,
    make_head,
    read_recording,
    replay,
    write_recording,
)
from needlefit.project.locate import find_file
from needlefit.project.toml import load
from needlefit.schemas.scene import SceneRecord

PLAIN = load(find_file("scene", "study2"), SceneRecord)


def read(text):
    """Return the changes of each step from rows of step, name, item and value, as a recording has them."""
    steps = defaultdict(list)
    for step, name, item, value in csv.reader(text.split()):
        steps[step].append(Change(name, int(item) if item else None, float(value)))
    return [tuple(changes) for changes in steps.values()]


WANDERING = read("""
1,depth_mm,,12.34567
2,base_y_mm,,0.1
2,base_slope,,-0.01
3,bevel_side,,-1
3,depth_mm,,20
4,guide_x_mm,1,-30
4,guide_y_mm,1,0.2
5,guide_slope,1,0.02
5,depth_mm,,25.1
6,mu_pa,1,1e5
6,alpha,2,3
7,return_to,,2
8,bevel_offset_mm,,0.03
8,depth_mm,,30
9,guide_x_mm,2,8
9,guide_y_mm,2,0.1
9,guide_turns_freely,2,1
10,offset_throughout_mm,,0.05
11,tip_held,,1
12,tip_y_mm,,0.5
13,depth_mm,,18
13,tip_held,,0
13,guide_engaged,2,0
14,return_to,,0
15,depth_mm,,5
""")


def nodes_y(shape):
    return compute_positions(shape, shape.x)[:, 1]


def recorded(path, changes=WANDERING):
    """Write a recording of changes; return the needle, with the y of its nodes after each step as `found`."""
    steering = SteeredNeedle(Scene.from_record(PLAIN), 1.0)
    steps = []
    steering.found = [nodes_y(steering.now.shape)]
    for n, step in enumerate(changes, start=1):
        steering.apply(step)
        if n == 2:
            steering.keep()
        steps.append(RecordedStep(n, 0.25 * n, step, steering.now.shape.tip_lateral))
        steering.found.append(nodes_y(steering.now.shape))
    write_recording(Recording(make_head("study2", 1.0, PLAIN), tuple(steps)), path)
    return steering


def test_a_replay_finds_the_same_bits_after_every_step(tmp_path):
    path = tmp_path / "log.csv"
    found = recorded(path).found
    again = list(replay(read_recording(path)))
    assert len(again) == len(found) == len(WANDERING) + 1
    for replayed, expected in zip(again, found, strict=True):
        np.testing.assert_array_equal(nodes_y(replayed.state.shape), expected)
    assert max(replayed.tip_offset_mm for replayed in again) == 0.0
    assert again[4].recorded.time == 1.0


@pytest.mark.parametrize("cut", [1, 20, 45])
def test_a_recording_cut_off_in_its_last_step_has_all_before(tmp_path, cut):
    """Killed while it wrote: the step of two rows at the end is there whole, or not at all."""
    path = tmp_path / "log.csv"
    recorded(path, [*WANDERING, *read("16,depth_mm,,9\n16,bevel_side,,-1")])
    path.write_bytes(path.read_bytes()[:-cut])
    assert [step.number for step in read_recording(path).steps] == list(range(1, len(WANDERING) + 1))


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ("1,0.2500,depth_mm", "1,0.2500,depth_m", "line .*: .*`depth_m`.*expected: .*depth_mm"),
        ("depth_mm,,12.34567", "depth_mm,,nan", "line .*: `nan`"),
        ("1,0.2500,depth_mm", "1,-0.1,depth_mm", "line .*: time_s is -0.1"),
        ("2,0.5000,base_slope,,-0.01", "2,0.5000,base_y_mm,,-0.01", "line .*: .*base_y_mm .*step 2"),
        ("2,0.5000,base_y_mm,,0.1,", "2,0.5000,base_y_mm,,0.1,0.7", "line .*: tip_lateral_mm"),
        ("depth_mm,,12.34567", f"depth_mm,{'9' * 5000},12.34567", "line .*: item"),
        ("5,1.2500,", "7,1.2500,", "step 7"),
        ("# first_cell_mm = 1.0", "# first_cell_mm = -1.0", "first_cell_mm"),
        ("depth_mm,,12.34567", "depth_mm,,500.0", "step 1 "),
        ("return_to,,2.0", "return_to,,77.0", "step 7 "),
    ],
)
def test_a_faulty_recording_is_refused_with_its_place(tmp_path, old, new, fault):
    path = tmp_path / "log.csv"
    recorded(path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    fault = fault.replace("line .*", f"line {text[: text.index(old)].count(chr(10)) + 1}")
    with pytest.raises(NeedlefitError, match=f"(?s)log.csv.*{fault}"):
        list(replay(read_recording(path)))
