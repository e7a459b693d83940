"""How often do fits of each kind of measurement find mu and b of simulated needles?

    python benchmarks/labs.py [--sets 20] [--seed 100] [--kinds shapes,tips] [--recipe quick]

Each set is a plain file of `tests/labs.py`. It is imported with --yes, and tuned by the command that the
import prints. A row for each kind: sets, 95 % intervals that contain the truth, and the median ratio of their
ends.
"""

import argparse
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "tests"))

from labs import LABS, TRUTH, Lab  # noqa: E402

NEEDLEFIT = (sys.executable, "-m", "needlefit")


def fit_lab(lab: Lab, seed: int, recipe: str, folder: Path) -> dict[str, tuple[float, float]]:
    """Return the 95 % intervals of mu and b of one set."""
    recipes = folder / "configs/recipes"
    recipes.mkdir(parents=True)
    shutil.copyfile(HERE.parent / f"configs/recipes/{recipe}.toml", recipes / "default.toml")
    lab.write(folder / "data.csv", np.random.default_rng(seed))
    words = [*NEEDLEFIT, "import", *lab.files, "--out", "lab", *lab.options()]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=True)
    (command,) = re.findall(r"needlefit (tune [^\n]*)", done.stdout + done.stderr)
    subprocess.run([*NEEDLEFIT, *shlex.split(command)], cwd=folder, capture_output=True, check=True)
    (table,) = folder.glob("reports/*/posterior.csv")
    values = pd.read_csv(table).set_index(["parameter", "probability"])["value"]
    return {name: (values[name, 0.025], values[name, 0.975]) for name in TRUTH}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sets", type=int, default=20)
    parser.add_argument("--seed", type=int, default=100, help="of the first set")
    parser.add_argument("--kinds", default=",".join(LABS))
    parser.add_argument("--recipe", default="default")
    asked = parser.parse_args()
    print("kind      sets  " + "  ".join(f"{name} in, ratio" for name in TRUTH))
    for kind in asked.kinds.split(","):
        found = []
        for seed in range(asked.seed, asked.seed + asked.sets):
            with TemporaryDirectory() as folder:
                found.append(fit_lab(LABS[kind], seed, asked.recipe, Path(folder)))
        cells = []
        for name, truth in TRUTH.items():
            low, high = np.array([one[name] for one in found]).T
            inside = int(np.sum((low < truth) & (truth < high)))
            cells.append(f"{inside}, {np.median(high / low):.2g}")
        print(f"{kind:9} {len(found):4}  " + "  ".join(f"{one:>14}" for one in cells), flush=True)


if __name__ == "__main__":
    main()
