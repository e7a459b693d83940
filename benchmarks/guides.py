"""Where `needlefit reconstruct` lets the needle enter, with guides and hubs that the design does not have.

    python benchmarks/guides.py --cache FOLDER

Two rows of the tuning part of `real_scanners.py` (needle along and in the slices) with glass balls of 3 mm
and, in place of their accessory: a plate of PMMA of 8 mm on the tissue (`flush`) or 2 mm before it (`gap`), a
guide of aluminium whose hole the needle fills, a hub of PMMA. Plates are reconstructed without and with
their stated thickness. `entry` is the error along the needle, mm; `named` whether a warning names candidates.
"""

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

from real_scanner_scenes import Row, make_case, read_design, render_cached
from real_scanners import make_recipe, write_scan

from needlefit.imaging.batch import ReconstructionFailure, reconstruct_needles

BASES = ("t18", "t04")
PLATES_MM = {"flush": 8.0, "gap": 8.0}
ACCESSORIES = ("flush", "gap", "aluminium", "plastic")


def main() -> None:
    """Reconstruct every scene and print a line for each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cache", type=Path, required=True, help="folder of the rendered volumes")
    arguments = parser.parse_args()
    rows = {row.name: row.levels for row in read_design("tuning")}
    for base in BASES:
        for accessory in ACCESSORIES:
            levels = {"material": "glass", "ball_mm": "3", "balls": "7", "accessory": accessory}
            row = Row(f"{base}-{accessory}", {**rows[base], **levels})
            for thickness in (None, PLATES_MM.get(accessory, 0.0)):
                print(describe(row, thickness, arguments.cache), flush=True)


def describe(row: Row, thickness: float | None, cache: Path) -> str:
    """Return the line of a scene, reconstructed with a stated thickness of the guide or none, mm."""
    case, recipe = make_case(row), make_recipe(row)
    volume = render_cached(case, cache)
    recipe = recipe.model_copy(update={"guide": recipe.guide.model_copy(update={"thickness_mm": thickness})})
    with TemporaryDirectory() as temporary:
        (found,) = reconstruct_needles(write_scan(case, volume, Path(temporary)), recipe)
    stated = "not stated" if thickness is None else f"stated as {thickness:g} mm"
    if isinstance(found, ReconstructionFailure):
        return f"{row.name}, guide {stated}: refused: {found.error.what}"
    named = any("guide.thickness_mm" in note for note in found.warnings)
    entry, sd = float(found.pose.origin[0]), found.pose.along_sd
    return f"{row.name}, guide {stated}: entry {entry:+.2f} mm, deviation {sd:.2f}, named {named}"


if __name__ == "__main__":
    main()
