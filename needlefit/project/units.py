"""Units that files and commands may state, and how much they are."""

UNITS_MM = {"mm": 1.0, "cm": 10.0, "dm": 100.0, "m": 1e3, "um": 1e-3, "in": 25.4}
"""Millimetres in each unit of length."""
UNITS_PER_MM = {f"1/{unit}": 1.0 / UNITS_MM[unit] for unit in ("m", "mm", "cm", "dm", "um", "in")}
"""One per millimetre in each unit of a curvature, the most usual first."""
UNITS_GPA = {"GPa": 1.0, "MPa": 1e-3, "kPa": 1e-6, "Pa": 1e-9}
"""Gigapascals in each unit of a modulus."""
