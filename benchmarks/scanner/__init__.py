"""A CT scanner that renders needles, balls and phantoms as volumes."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[2] / "studies"))  # of the synthetic dataset's phantoms
