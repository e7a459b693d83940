"""A needle of known equation in a small synthetic scan."""

import numpy as np
from scanner.render import Needle3D, Scanner, Scene3D, densify, render_scan
from synthetic.design import Phantom

from needlefit.geometry.frames import Frame
from needlefit.imaging.volume import VoxelGrid
from needlefit.schemas.reconstruction import ReconstructionRecord

RECIPE = ReconstructionRecord(schema=2)
SPACING = 0.46
SHAPE = (48, 48, 110)  # 22 x 22 x 50 mm
ENTRY = np.array([11.0, 11.0, 12.0])  # 12 mm of the box's face lie in air


def recipe(**tables):
    """The default recipe with some tables' entries replaced."""
    return ReconstructionRecord.model_validate({"schema": 1, **tables})


def axis(tip=(0.0, 0.0, 28.0), curve=(0.0, 0.0)):
    """`ENTRY` + (tip_xy s + curve s^2, tip_z s); s from -1, outside, to 1; s^2 from the entry on."""
    s = np.linspace(-1.0, 1.0, 81)[:, None]
    across = np.asarray(tip[:2]) * s + np.asarray(curve) * np.clip(s, 0, None) ** 2
    return ENTRY + np.column_stack([across, tip[2] * s])


def box():
    """A box whose entry face is the plane S = 12 mm; the needle goes along S."""
    return Frame(ENTRY, np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]))


def grid(**changes):
    """The test's voxels."""
    plain = {"size": SHAPE, "origin": np.zeros(3), "spacing": np.full(3, SPACING), "direction": np.eye(3)}
    return VoxelGrid(**(plain | changes))


def scan(points, seed=1, scene=None, bevel_deg=30.0, hu=9000.0, layers_hu=(40.0, 90.0), **scanner):
    """A scan of the needle `points`; noise 30 HU, no artefacts unless asked for."""
    plain = {"grid": grid(), "noise_hu": 30.0, "streaks": 0.0, "bloom": 0.0, "cupping_hu": 0.0}
    extra = scene or {}
    needles = extra.pop("needles", ()) if scene else ()
    bevelled = Needle3D(points, bevel_deg=bevel_deg, bevel_toward=np.array([0.0, 1, 0]), hu=hu)
    whole = Scene3D((bevelled, *needles), Phantom((14.0,)), layers_hu, box(), **extra)
    return render_scan(whole, Scanner(**(plain | scanner)), np.random.default_rng(seed))


def off(points, truth):
    """How far `points` lie from the line through `truth`, mm."""
    fine = densify(truth)
    gaps = np.linalg.norm(points[:, None] - fine[None], axis=2)
    nearest = np.clip(gaps.argmin(axis=1), 1, len(fine) - 2)
    tangent = fine[nearest + 1] - fine[nearest - 1]
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    d = points - fine[nearest]
    return np.linalg.norm(d - np.sum(d * tangent, axis=1, keepdims=True) * tangent, axis=1)
