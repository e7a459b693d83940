"""How well radiopaque balls are found in synthetic scans, how sure of it, and how fast.

    python benchmarks/markers.py [--volumes 180] [--seed 5001] [--jobs 2] [--large] [--json]

The random scans of `reconstruction.py`, `clean`, with `artefacts` or with `streaks` too, and in each six
balls of 3 mm anywhere in view, on the phantom's face in three of ten draws, at least 0.9 mm of free space
from the needle: glass to tungsten, one material a scan. Every second scan has voxels of 0.46 mm, the others
edges of 0.3 to 1 mm along each axis. Errors in each direction against the centres rendered, mm, of the fit
and of the intensity-weighted centre of the same voxels; `covered` is the part of the fit's within one stated
standard deviation. The needle's voxels come from its own segmentation. `--large` times one volume of
512 x 512 x 400.
"""

import argparse
import time
import tracemalloc
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from reconstruction import KINDS, RECIPE, Case, draw_case
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from needlefit.errors import DataError
from needlefit.geometry.frames import Frame
from needlefit.imaging.markers import find_markers
from needlefit.imaging.needle.segmentation import select_needle
from needlefit.imaging.volume import Volume, to_index, to_patient
from needlefit.synthetic.render import SceneMarkers, VoxelGrid, densify, render_scan

Floats = NDArray[np.float64]

BALLS = 6
GLASS, TUNGSTEN = 1500.0, 12000.0
FROM_FACE, FROM_NEEDLE, FROM_TABLE, APART = 2.5, 3.0, 4.0, 6.0
ON_FACE = 0.3
MATCHED = 1.0
SCAN = ["seed", "kind", "voxels"]


def draw(kind: str, odd: bool, rng: np.random.Generator, shape: tuple[int, int, int] | None = None) -> Case:
    """Draw a scan with balls of known centres; `odd`: with voxels of any shape."""
    case = draw_case(kind, rng, shape)
    grid = case.scanner.grid
    if odd:
        spacing = rng.uniform(0.3, 1.0, 3)
        size = np.ceil(np.array(grid.size) * grid.spacing / spacing).astype(int)
        grid = VoxelGrid((int(size[0]), int(size[1]), int(size[2])), grid.origin, spacing, grid.direction)
    balls = SceneMarkers(_centers(case, grid, rng), hu=rng.uniform(GLASS, TUNGSTEN))
    scanner = replace(case.scanner, grid=grid)
    return replace(case, scene=replace(case.scene, markers=balls), scanner=scanner)


def _centers(case: Case, grid: VoxelGrid, rng: np.random.Generator) -> Floats:
    """Return places in view, clear of needle, table and each other (`BALLS`, 3)."""
    size = np.array(grid.size) * grid.spacing
    needle, box, table = cKDTree(densify(case.axis)), case.scene.box, case.scene.table
    found: list[Floats] = []
    while len(found) < BALLS:
        local = box.to_local(_at(grid, rng.uniform(0, size))[None])
        if rng.random() < ON_FACE:
            local[0, 0] = rng.uniform(-2, 2)
        point = box.to_world(local)
        inside = (point[0] - grid.origin) @ grid.direction
        clear = [
            inside.min() >= FROM_FACE and (size - inside).min() >= FROM_FACE,
            needle.query(point[0])[0] >= FROM_NEEDLE,
            table is None or table.frame.to_local(point)[0, 2] >= FROM_TABLE,
            not found or cdist(point, found).min() >= APART,
        ]
        if all(clear):
            found.append(point[0])
    return np.array(found)


def _at(grid: VoxelGrid, steps: Floats) -> Floats:
    return Frame(grid.origin, grid.direction).to_world(steps[None])[0]


def one(task: tuple[int, str, bool]) -> list[dict[str, object]]:
    """Return a line for every ball of one random scan, and for everything else that was taken for one."""
    seed, kind, odd = task
    rng = np.random.default_rng([seed, KINDS.index(kind), odd])
    case = draw(kind, odd, rng)
    volume = render_scan(case.scene, case.scanner, rng)
    start = time.process_time()
    found = find_markers(volume, RECIPE, needle_of(volume))
    about = {"seed": seed, "kind": kind, "voxels": "0.3-1 mm" if odd else "0.46 mm"}
    about |= {"seconds": time.process_time() - start, "hu": case.scene.markers.hu}
    lines: list[dict[str, object]] = []
    apart = cdist(case.scene.markers.centers, found.centers)
    for true, gaps in zip(case.scene.markers.centers, apart, strict=True):
        if not len(gaps) or gaps.min() > MATCHED:
            lines.append(about | {"was": "missed"})
            continue
        n = int(gaps.argmin())
        error, rough = found.centers[n] - true, centroid(volume, found.centers[n]) - true
        lines.append(
            about
            | {"was": "found", "square": float(np.mean(error**2)), "worst": float(np.abs(error).max())}
            | {"rough": float(np.mean(rough**2)), "sd": found.sd[n]}
            | {"covered": float(np.mean(np.abs(error) <= found.sd[n]))}
        )
    spurious = np.count_nonzero(apart.min(axis=0) > MATCHED) if apart.size else 0
    return lines + spurious * [about | {"was": "false"}]


def needle_of(volume: Volume) -> NDArray[np.int64] | None:
    """Return the needle's voxels, None where its segmentation fails."""
    try:
        return select_needle(volume, RECIPE).needle.voxels
    except DataError:
        return None


def centroid(volume: Volume, start: Floats) -> Floats:
    """Return the centre of what outshines the rim, five times over, from the place where the ball is."""
    center = start
    low = np.floor(to_index(volume, start[None])[0] - 3 / volume.spacing).astype(int).clip(0)
    high = low + np.ceil(6 / volume.spacing).astype(int) + 1
    block = volume.values[low[2] : high[2], low[1] : high[1], low[0] : high[0]]
    places = to_patient(volume, np.argwhere(np.ones(block.shape))[:, ::-1] + low)
    values = block.ravel().astype(np.float64)
    for _ in range(5):
        r = np.linalg.norm(places - center, axis=1)
        over = np.clip(values - np.median(values[(r > 2.25) & (r < 3)]), 0, None) * (r < 2.1)
        center = over @ places / over.sum()
    return center


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the figures by kind and voxels, and over all scans."""
    lines = []
    everything = rows.assign(kind="all", voxels="")
    for names, group in pd.concat([rows, everything]).groupby(["kind", "voxels"], sort=False):
        kind, voxels = names
        counts = group["was"].value_counts()
        lines.append(
            {"kind": kind, "voxels": voxels, "scans": len(rows.loc[group.index].drop_duplicates(SCAN))}
            | {what: int(counts.get(what, 0)) for what in ("found", "missed", "false")}
            | {"rms_mm": np.sqrt(group["square"].mean()), "worst_mm": group["worst"].max()}
            | {"centroid_rms_mm": np.sqrt(group["rough"].mean()), "sd_mm": group["sd"].mean()}
            | {"covered": group["covered"].mean(), "seconds": group["seconds"].mean()}
        )
    return pd.DataFrame(lines)


def large(rng: np.random.Generator) -> dict[str, float]:
    """Return the time and memory of a volume of 512 x 512 x 400 voxels."""
    case = draw("streaks", False, rng, shape=(512, 512, 400))
    # streaks of so large a volume take minutes to render
    volume = render_scan(case.scene, replace(case.scanner, streaks=0.0), rng)
    start = time.perf_counter()
    found = find_markers(volume, RECIPE)
    seconds = time.perf_counter() - start
    tracemalloc.start()  # which slows down: once more
    find_markers(volume, RECIPE)
    extra = tracemalloc.get_traced_memory()[1]
    apart = cdist(case.scene.markers.centers, found.centers)
    return {
        "seconds": seconds,
        "volume_gb": volume.values.nbytes / 1e9,
        "extra_gb": extra / 1e9,
        "found": float(np.count_nonzero(apart.min(axis=1) < MATCHED)),
        "markers": float(len(found.centers)),
    }


def main() -> None:
    """Run the scans and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--volumes", type=int, default=180)
    parser.add_argument("--seed", type=int, default=5001)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--large", action="store_true")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--rows", help="also write every ball's figures to this CSV")
    arguments = parser.parse_args()
    if arguments.large:
        print(large(np.random.default_rng(arguments.seed)))
        return
    tasks = [(arguments.seed + n // 6, KINDS[n // 2 % 3], bool(n % 2)) for n in range(arguments.volumes)]
    with ProcessPoolExecutor(arguments.jobs) as pool:
        rows = pd.DataFrame([line for group in pool.map(one, tasks) for line in group])
    if arguments.rows:
        rows.to_csv(arguments.rows, index=False)
    table = summary(rows)
    if arguments.json:
        print(table.to_json(orient="records", indent=2))
        return
    print(table.to_string(index=False, float_format=lambda x: f"{x:.4f}"))
    print("goals: rms 0.05 mm clean, 0.1 with streaks, at 0.46 mm; coverage 0.68 +- 0.05")


if __name__ == "__main__":
    main()
