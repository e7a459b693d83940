"""How large an input may be: far above real use, and small enough for a minute and 2 GB of memory.

`benchmarks/bounds.py` measures the worst inputs that are still accepted.
"""

MAX_NUMBER = 1e15
"""Of every number in a file or message: products of up to twenty of them stay finite."""

MAX_NEEDLE_LENGTH_MM = 5000.0
"""Needles, catheters and guide wires have up to about 2 m."""

MAX_NEEDLE_DIAMETER_MM = 10_000.0
"""A diameter in micrometres is below it, so that its unit is named in a warning."""

MIN_ELEMENT_MM = 0.05
"""Of an element and of the constraint spacing; below, rounding exceeds the discretisation error."""

MAX_CONSTRAINT_SPACING_MM = 10.0
"""The model takes 1 mm; elements fill a cell however long it is, and so do time and memory."""

MAX_ELEMENTS = 5000
"""Elements in the tissue: 5 m in elements of 1 mm, 250 mm in those of 0.05 mm."""

MAX_ELEMENT_SOLVES = 12_500_000
"""Elements solved for in all equilibria of an insertion; one to `MAX_ELEMENTS` without a halt has as many."""

MAX_BATCH_ELEMENT_SOLVES = 200_000_000
"""The same of all parameter sets of a batch."""

MAX_BATCH_NODES = 20_000_000
"""Nodes of all shapes of a batch: 1.1 GB."""

MAX_SHOWN_POSITIONS = 5000
"""Places on its way at which an insertion is shown."""

MAX_EVALUATION_ELEMENT_SOLVES = 50_000_000
"""The same of all insertions that one evaluation of a fit simulates."""

MAX_STEPS = 10_000
"""Of a scene; and rays that an interactive needle may have cut."""

MAX_LAYERS = 200
"""Of a tissue or medium."""

MAX_GUIDES = 50
"""Of a scene."""

MAX_ITERATIONS = 200
"""Of Newton's method in one equilibrium."""

MAX_STARTS = 10_000
"""Of a search."""

MAX_EVALUATIONS = 10_000_000
"""Of one start."""

MAX_ENSEMBLES = 100
"""Of a sampler."""

MAX_WALKERS = 2000
"""Of an ensemble."""

MAX_STORED_DRAWS = 4_000_000
"""Ensembles x walkers x steps; a draw of ten parameters takes 80 bytes, and four copies of all are held."""

MAX_STORED_NUMBERS = 50_000_000
"""Draws x parameters: 400 MB a copy."""

MAX_REPLICATES = 10_000
"""Repetitions of a whole study: seeds, made-up specimens, orders, truths of a calibration."""

MAX_RESAMPLES = 100_000
"""Of a bootstrap."""

MAX_CANDIDATES = 1000
"""Members of a list of depths, angles or entries that are all tried."""

MAX_SEED = 2**63 - 1
"""Of all randomness: the largest whole number of a TOML file."""
