"""What it costs to read scans and MATLAB files in a child process: against the same reader in this one.

    python benchmarks/readers.py [--rounds 5] [--slices 300] [--json]

Every file is read in a new interpreter, as a command does: once in the child (`child`), once by the same
function in the process itself (`inside`). Seconds are the least of all rounds, from before the reader is
imported, on the wall and of processor time; `memory_mib` is what the process that asked for the file holds in
the end, anonymous and shared, before it looks at a voxel.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
from scanner.write import write_volume
from scipy.io import savemat

from needlefit.imaging.volume import Volume
from needlefit.project.locate import shipped_folder

VOXELS = 512

MEASURE = """
import json, sys, time
from pathlib import Path
path, way = Path(sys.argv[1]), sys.argv[2]
import os
begin, started = time.perf_counter(), sum(os.times()[:4])
if way == "child":
    if path.suffix == ".mat":
        from needlefit.datasets.formats.mat import read_curves as read
    else:
        from needlefit.imaging.volume_files import read_volume as read
    kept = read(path)
else:
    kept = {}
    if path.suffix == ".mat":
        from needlefit.datasets.formats.mat import read_variables
        read_variables(kept, str(path))
    elif path.is_dir():
        from needlefit.imaging.dicom import read_series
        read_series(kept, str(path), None, None)
    else:
        from needlefit.imaging.image_files import read_image
        read_image(kept, str(path), path.stat().st_size)
seconds = time.perf_counter() - begin
status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
memory = sum(int(status[name].split()[0]) for name in ("RssAnon", "RssShmem")) / 1024
work = sum(os.times()[:4]) - started
print(json.dumps([seconds, work, memory]))
"""


def write_files(folder: Path, slices: int) -> dict[str, Path]:
    """Return the files to read, by what the table calls them."""
    rng = np.random.default_rng(1)
    values = rng.normal(0, 20, (slices, VOXELS, VOXELS)).astype(np.float32).round()
    volume = Volume(values, np.zeros(3), np.array([0.4, 0.4, 0.6]), np.eye(3))
    size = f"{VOXELS} x {VOXELS} x {slices}"
    for name in ("a.nii", "a.nrrd", "series"):
        write_volume(volume, folder / name)
    savemat(folder / "a.mat", {"needle": rng.normal(size=(200, 3))})
    return {
        "sample scan, .nrrd": next((shipped_folder() / "data" / "sample_scan").rglob("*.nrrd")),
        f"{size}, .nii": folder / "a.nii",
        f"{size}, .nrrd packed": folder / "a.nrrd",
        f"{size}, DICOM": folder / "series",
        "200 points, .mat": folder / "a.mat",
    }


def measured(path: Path, way: str, rounds: int) -> tuple[float, float, float]:
    """Return the least seconds, the least of processor time, children included, and the memory, MiB."""
    command = [sys.executable, "-c", MEASURE, str(path), way]
    found = [json.loads(subprocess.check_output(command)) for _ in range(rounds)]
    seconds, work, memory = zip(*found, strict=True)
    return min(seconds), min(work), memory[-1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--slices", type=int, default=300)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    rows = []
    with TemporaryDirectory() as folder:
        for name, path in write_files(Path(folder), given.slices).items():
            child, work, held = measured(path, "child", given.rounds)
            inside, work_inside, held_inside = measured(path, "inside", given.rounds)
            rows.append(
                {
                    "file": name,
                    "child_s": round(child, 3),
                    "inside_s": round(inside, 3),
                    "difference_s": round(child - inside, 3),
                    "ratio": round(child / inside, 2),
                    "child_cpu_s": round(work, 2),
                    "inside_cpu_s": round(work_inside, 2),
                    "memory_mib": round(held),
                    "memory_inside_mib": round(held_inside),
                }
            )
    print(json.dumps(rows, indent=2) if given.json else pd.DataFrame(rows).to_string(index=False))


if __name__ == "__main__":
    main()
