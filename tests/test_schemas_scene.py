"""Scenes: the shipped ones hold the paper's parameter sets; what a scene's file may say."""

import csv
import tomllib

import pytest

from needlefit.errors import ConfigError
from needlefit.project.locate import find_file, shipped_folder
from needlefit.project.toml import check, load
from needlefit.schemas.scene import SceneRecord, resolve_steps

PAPER = shipped_folder() / "data" / "paper"
TUNED_ON = {"study1": "phantom2", "study2": "phantom2", "study3": "phantom2", "study4": "phantom2"}
TUNED_ON |= {"study5": "chicken", "phantom2_by_layers": "phantom2"}


def rows(name):
    with (PAPER / f"{name}.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


SETS = rows("parameters")


def scene(name):
    return load(find_file("scene", name), SceneRecord)


@pytest.mark.parametrize("row", SETS, ids=lambda row: row["set"])
def test_a_scene_holds_the_published_parameters(row):
    """Its depth is the middle of its medium's insertions."""
    record, name = scene(row["set"]), row["set"]
    printed = [(row[f"mu{n}_pa"], row[f"alpha{n}"]) for n in (1, 2, 3, 4) if row[f"mu{n}_pa"]]
    assert [(layer.mu_pa, layer.alpha) for layer in record.layers] == [
        (float(mu), float(a)) for mu, a in printed
    ]
    assert record.bevel.offset_mm == float(row["bevel_mm"])
    assert [layer.top_mm for layer in record.layers] == [0, 20, 28, 45][: len(printed)]
    ranges = [one for one in rows("insertions") if one["medium"] == TUNED_ON.get(name, name)]
    depths = [float(one[key]) for one in ranges for key in ("depth_min_mm", "depth_max_mm")]
    assert record.depth_mm == pytest.approx((min(depths) + max(depths)) / 2)
    assert (record.needle.length_mm, record.needle.outer_diameter_mm) == (150, 1.27)
    assert record.needle.youngs_modulus_gpa == 80
    assert len(record.layers) == 1 or "invented" in record.note


BARE = {
    "schema": 1,
    "needle": {"length_mm": 90, "flexural_rigidity_nmm2": 1e4},
    "bevel": {"offset_mm": 0.1},
    "layers": [{"top_mm": 0, "mu_pa": 1e5, "alpha": 1}],
}
RING = {"name": "ring", "x_mm": -9, "y_mm": 0}


STEPS = """
guides = [{ name = "ring", x_mm = -9, y_mm = 0 }]
controls = { base_y_mm = 1, stage_angle_deg = 4 }
steps = [
    { depth_mm = 10 },
    { depth_mm = 20, side = -1, base_y_mm = 2, guides.ring.y_mm = 0.5 },
    { depth_mm = 5, offset_mm = 0.3, tip_y_mm = 0.1, tip_slope_deg = 3 },
    { depth_mm = 5, tip_y_mm = 0.2, base_slope_deg = -1 },
    { depth_mm = 6, guides.ring.engaged = false },
    { depth_mm = 6, tip_free = true },
]
"""


def test_unset_values_of_a_step_carry_over():
    record = check(BARE | tomllib.loads(STEPS), SceneRecord, "a.toml")
    fields = ("base_y_mm", "base_slope_deg", "tip_y_mm", "tip_slope_deg", "stage_angle_deg")
    found = []
    for step in resolve_steps(record):
        ((key, ring),) = step.guides
        held = [getattr(step.controls, name) for name in fields]
        found.append(
            (step.depth_mm, step.bevel.offset_mm, step.bevel.side, *held, key, ring.y_mm, ring.engaged)
        )
    moved = "steps.2.guides.ring"
    assert found == [
        (10, 0.1, 1, 1, 0, None, None, 4, "guides.1", 0, True),
        (20, 0.1, -1, 2, 0, None, None, 4, moved, 0.5, True),
        (5, 0.3, -1, 2, 0, 0.1, 3, 4, moved, 0.5, True),
        (5, 0.3, -1, 2, -1, 0.2, None, 4, moved, 0.5, True),
        (6, 0.3, -1, 2, -1, 0.2, None, 4, "steps.5.guides.ring", 0.5, False),
        (6, 0.3, -1, 2, -1, None, None, 4, "steps.5.guides.ring", 0.5, False),
    ]


def test_a_side_and_a_roll_take_each_other_s_place():
    turns = [{"side": -1}, {"roll_deg": 90}, {"offset_mm": 0.2}, {"side": -1}, {"side": 1}]
    steps = [{"depth_mm": n + 1} | step for n, step in enumerate(turns)]
    bevels = [step.bevel for step in resolve_steps(check(BARE | {"steps": steps}, SceneRecord, "a.toml"))]
    assert [(one.side, one.roll_deg) for one in bevels] == [
        (-1, None),
        (1, 90),
        (1, 90),
        (-1, None),
        (1, None),
    ]


STEP = {"depth_mm": None}  #: of a scene whose only depth is that of its step


@pytest.mark.parametrize(
    ("more", "key"),
    [
        ({"steps": [{"depth_mm": 5}]}, "depth_mm"),
        (STEP | {"steps": [{"side": 1}]}, "steps.1.depth_mm"),
        *((STEP | {"steps": [{"depth_mm": 1} | step]}, key) for step, key in (
            ({"sied": 1}, "steps.1.sied"),
            ({"guides": {"rang": {}}}, "steps.1.guides.rang"), ({"tip_slope_deg": 1}, "steps.1"),
            ({"side": -1, "roll_deg": 180.0}, "steps.1"), ({"tip_z_mm": 1}, "steps.1"),
            ({"tip_y_mm": 1, "tip_slope_z_deg": 1}, "steps.1"),
            ({"tip_y_mm": 1, "tip_free": True}, "steps.1"))),
        ({"controls": {"tip_slope_deg": 1}}, "controls"),
        ({"bevel": {"offset_mm": 0.1, "side": -1, "roll_deg": 90}}, "bevel"),
        ({"guides": [RING, RING]}, "guides.2.name"), ({"guides": [RING | {"name": "7"}]}, "guides.1.name"),
        ({"controls": {"base_slope_deg": 50}}, "controls.base_slope_deg"), ({"bevel": {}}, "bevel.offset_mm"),
        ({"layers": [{"top_mm": 0, "alpha": 1}]}, "layers.1.mu_pa"),
    ],
)  # fmt: skip
def test_an_error_names_its_key(more, key):
    tables = BARE | {"depth_mm": 5, "guides": [RING]} | more
    with pytest.raises(ConfigError) as fault:
        check({name: value for name, value in tables.items() if value is not None}, SceneRecord, "a.toml")
    assert f"`{key}`" in fault.value.what
