"""How far boundaries drawn from labelled voxels lie from the true ones: python benchmarks/label_surfaces.py.

Planes and cylinders of random tilt and place in a grid of 0.46 mm; points are drawn evenly over the surfaces,
away from their ends.
"""

import numpy as np
import trimesh

from needlefit.geometry.meshes import extract_solid
from needlefit.imaging.layers import extract_boundary

SPACING = 0.46
SIZE = 91
CASES = 20
POINTS = 4000


def drawn(mask: np.ndarray, seed: int) -> np.ndarray:
    """Return points (POINTS, 3) on the boundary of a mask, mm."""
    vertices, faces = extract_boundary(mask, np.full(3, SPACING))
    surface, _ = extract_solid("mask", vertices * SPACING, faces, into=1)
    return np.asarray(trimesh.sample.sample_surface(surface.mesh, POINTS, seed=seed)[0])


def main() -> None:
    """Print the errors of planes and of cylinders."""
    rng = np.random.default_rng(1)
    steps = np.arange(SIZE) * SPACING
    grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1)
    middle = steps.mean()
    errors: dict[str, list[np.ndarray]] = {"plane": [], "cylinder, r = 10 mm": [], "cylinder, r = 5 mm": []}
    for seed in range(CASES):
        axis, shift = rng.normal(size=3), rng.uniform(-1, 1, 3)
        axis /= np.linalg.norm(axis)
        local = grid - middle - shift
        points = drawn(local @ axis < 0, seed) - middle - shift
        errors["plane"].append(points[np.abs(points).max(axis=1) < 15] @ axis)
        along = local @ axis
        away = np.linalg.norm(local - along[..., None] * axis, axis=-1)
        for name, radius in (("cylinder, r = 10 mm", 10.0), ("cylinder, r = 5 mm", 5.0)):
            points = drawn((away < radius) & (np.abs(along) < 14), seed) - middle - shift
            height = points @ axis
            out = np.linalg.norm(points - height[:, None] * axis, axis=1) - radius
            errors[name].append(out[np.abs(height) < 11])
    for name, parts in errors.items():
        e = np.concatenate(parts)
        size = np.abs(e)
        print(
            f"{name:20} mean |e| {size.mean():.3f}   bias {e.mean():+.3f}   "
            f"95 % {np.quantile(size, 0.95):.3f}   largest {size.max():.3f} mm"
        )


if __name__ == "__main__":
    main()
