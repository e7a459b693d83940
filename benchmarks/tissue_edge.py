"""How well the place is found where a needle enters the tissue, whatever the slant of the face it enters.

    python benchmarks/tissue_edge.py [--scans 20] [--seed 7]

Random scans of 60 x 60 x 100 voxels of 0.46 mm, turned at random; the needle bends from the entry on. The
face is tilted against it by 0, 10, 20 and 30 degrees. A third each is `clean` (partial volume, point spread,
noise), has `artefacts` (bloom, cupping, markers, a layer close behind the face) or these and `streaks`.
Errors against the rendered face, mm; `covered` is the part within one stated deviation.
"""

import argparse

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from needlefit.geometry.frames import Frame, make_entry_frame, normalize
from needlefit.imaging.materials import find_tissue_edge, sample_profile
from needlefit.synthetic.design import Phantom
from needlefit.synthetic.render import Needle3D, Scanner, Scene3D, SceneMarkers, VoxelGrid, render_scan

Floats = NDArray[np.float64]

KINDS = ("clean", "artefacts", "streaks")
TILTS = (0.0, 10.0, 20.0, 30.0)
SPACING = 0.46
S = np.linspace(-60.0, 18.0, 157)
"""Along the needle from its entry, mm."""


def draw_scene(tilt: float, rich: bool, grid: VoxelGrid, rng: np.random.Generator) -> Scene3D:
    """Draw a scene whose needle enters through a face tilted by `tilt` (rad) against it."""
    way = normalize(grid.direction[:, int(np.argmax(grid.size))] + 0.15 * rng.normal(size=3))
    side = normalize(np.cross(way, rng.normal(size=3)))
    entry = grid.direction @ rng.uniform(-3, 3, 3)
    into = np.cos(tilt) * way + np.sin(tilt) * side
    box = make_entry_frame(entry, into, np.cross(into, rng.normal(size=3)))
    bend = rng.choice([-1, 1]) * 0.012 * np.clip(S, 0, None) ** 2
    needle = Needle3D(entry + S[:, None] * way + bend[:, None] * side, hu=rng.uniform(6000, 11000))
    layers = (*rng.uniform(-80, 150, 2),)
    phantom = Phantom((float(rng.uniform(3, 15)) if rich else 25.0,))
    return Scene3D((needle,), phantom, layers, box, _markers(box, rng) if rich else None)


def draw_scanner(kind: str, grid: VoxelGrid, rng: np.random.Generator) -> Scanner:
    """Draw a scanner of `kind`."""
    rich = kind != "clean"
    return Scanner(
        grid,
        psf_mm=rng.uniform(0.3, 0.5),
        noise_hu=rng.uniform(20, 80),
        bloom=rng.uniform(0.05, 0.15) if rich else 0.0,
        cupping_hu=rng.uniform(0, 100) if rich else 0.0,
        streaks=rng.uniform(0.5, 1.0) if kind == "streaks" else 0.0,
    )


def _markers(box: Frame, rng: np.random.Generator) -> SceneMarkers:
    angle, radius = rng.uniform(0, 2 * np.pi, 6), rng.uniform(8, 16, 6)
    local = np.column_stack([rng.uniform(-6, 20, 6), radius * np.cos(angle), radius * np.sin(angle)])
    return SceneMarkers(box.to_world(local))


def one(kind: str, tilt: float, rng: np.random.Generator) -> dict[str, float | str]:
    """Return the error of the entry's place in one random scan, and the deviation stated."""
    turn = Rotation.random(random_state=np.random.RandomState(rng.integers(2**31))).as_matrix()
    shape = tuple(int(n) for n in np.roll([100, 60, 60], rng.integers(3)))
    grid = VoxelGrid(shape, -turn @ ((np.array(shape) - 1) / 2 * SPACING), np.full(3, SPACING), turn)
    scene = draw_scene(np.deg2rad(tilt), kind != "clean", grid, rng)
    volume = render_scan(scene, draw_scanner(kind, grid, rng), rng)
    found = find_tissue_edge(sample_profile(volume, scene.needles[0].points, S))
    error, sd = found or (np.nan, np.nan)
    return {"kind": kind, "tilt_deg": tilt, "error": error, "sd": sd}


def main() -> None:
    """Run the scans and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scans", type=int, default=20, help="of each kind and tilt")
    parser.add_argument("--seed", type=int, default=7)
    arguments = parser.parse_args()
    cases = [(kind, tilt, n) for kind in KINDS for tilt in TILTS for n in range(arguments.scans)]
    rows = pd.DataFrame(
        one(kind, tilt, np.random.default_rng([arguments.seed, KINDS.index(kind), int(tilt), n]))
        for kind, tilt, n in cases
    )
    rows["covered"] = (rows["error"].abs() <= rows["sd"]).astype(float)
    groups = rows.groupby(["kind", "tilt_deg"], sort=False)
    table = groups.agg(
        missed=("error", lambda e: int(e.isna().sum())),
        bias_mm=("error", "mean"),
        scatter_mm=("error", "std"),
        worst_mm=("error", lambda e: e.abs().max()),
        stated_sd_mm=("sd", "mean"),
        covered=("covered", "mean"),
    )
    print(table.to_string(float_format=lambda x: f"{x:.3f}"))
    print(
        f"all scans: mean |error| {rows['error'].abs().mean():.3f} mm, covered {rows['covered'].mean():.2f}"
    )


if __name__ == "__main__":
    main()
