"""A scene in the world: poses seen from C, steps that carry on, and the paper's Fig. 1."""

import math
import tomllib

from pytest import approx

from needlefit import Bevel, TrackedTip
from needlefit.mechanics.scene import Scene, simulate_scene
from needlefit.project.toml import check
from needlefit.schemas.scene import SceneRecord

SCENE = """
schema = 1
needle = { length_mm = 100, flexural_rigidity_nmm2 = 1e4 }
bevel = { offset_mm = 0.1 }
layers = [{ top_mm = 0, mu_pa = 1e5, alpha = 1 }, { top_mm = 12, mu_pa = 2e6, alpha = -1 }]
"""


def built(stated):
    """Return the scene with what TOML text states, also in the place of what is above."""
    return Scene.from_record(check(tomllib.loads(SCENE) | tomllib.loads(stated), SceneRecord, "a.toml"))


def test_a_roll_by_half_turns_is_a_side():
    rolls = {0: (1, 0), 180: (-1, 0), -180: (-1, -360), 360: (1, 360), 540: (-1, 360), 90: (1, 90)}
    for degrees, (side, rest) in rolls.items():
        scene = built(f"depth_mm = 20\nbevel = {{ offset_mm = 0.1, roll_deg = {degrees} }}")
        assert scene.steps[0].bevel == Bevel(0.1, side, 0.0, rest)
        assert simulate_scene(scene)[-1].leaves_plane == (degrees == 90)


ALONG_Z = """
depth_mm = 20
torsional_friction_n = 0.2
guides = [{ name = "g", x_mm = -8, y_mm = 0.1, z_mm = 0.4, angle_deg = 30, elevation_deg = 10 }]

[controls]
base_z_mm = 0.3
base_slope_z_deg = 2
stage_angle_deg = 20
stage_elevation_deg = -5
tip_y_mm = 0.1
tip_z_mm = -0.2
tip_slope_deg = 1
tip_slope_z_deg = 3
"""


def test_inputs_along_z_are_read():
    scene = built(ALONG_Z)
    (step,), tan = scene.steps, lambda degrees: math.tan(math.radians(degrees))
    held = step.controls
    assert (held.base_z, held.base_slope_z) == approx((0.3, tan(2)))
    # along (cos e cos a, cos e sin a, sin e)
    assert held.stage_slope_z == approx(tan(-5) / math.cos(math.radians(20)))
    assert held.guides[0].z == 0.4
    assert held.guides[0].slope_z == approx(tan(10) / math.cos(math.radians(30)))
    assert held.tip == TrackedTip(0.1, tan(1), -0.2, tan(3))
    assert scene.tissue.torsional_friction == 0.2
    shapes = simulate_scene(scene)
    assert shapes[-1].converged and shapes[-1].w[-1] == approx(-0.2)


WORLD = """
depth_mm = 15
entry = { x_mm = 1, y_mm = 2, angle_deg = 90 }  # C's x points up, its y to the left
guides = [
    { name = "held", x_mm = 0.5, y_mm = -18, angle_deg = 100 },
    { name = "ring", x_mm = 1, y_mm = -8, turns_freely = true },
    { name = "deep", x_mm = 1.25, y_mm = 7, in_tissue = true },
    { name = "open", x_mm = 9, y_mm = 9, engaged = false },
]
controls = { base_y_mm = 3, base_slope_deg = 2, stage_angle_deg = 91, tip_y_mm = 0.5, tip_slope_deg = 1 }
"""


def test_world_coordinates_of_a_file_are_transformed_to_c():
    (step,) = built(WORLD).steps
    held, ring, deep = step.controls.guides
    assert (held.x, held.y) == approx((-20, 0.5)) and held.slope == approx(math.tan(math.radians(10)))
    assert (ring.x, ring.y) == approx((-10, 0)) and ring.slope is None
    assert (deep.x, deep.y, deep.slope) == approx((5, -0.25, 0)) and deep.in_tissue
    assert step.controls.base_y == 3
    assert step.controls.base_slope == approx(math.tan(math.radians(2)))
    assert step.controls.stage_slope == approx(math.tan(math.radians(1)))
    assert step.controls.tip == TrackedTip(0.5, math.tan(math.radians(1)))
