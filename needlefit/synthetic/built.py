"""One insertion of the twin, all the way: what is true, how it was scanned, what the scan tells."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from needlefit.imaging.reconstruction import Reconstruction
from needlefit.synthetic.ct.insertion import Exposure
from needlefit.synthetic.ct.metal import dense
from needlefit.synthetic.twin import Twin

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Built:
    """An insertion, its scan and its reconstruction."""

    twin: Twin
    exposure: Exposure
    reconstruction: Reconstruction


def registration_errors(built: Built) -> Floats:
    """Return how far the registration moves each point of the true centreline (N,), mm."""
    true = built.twin.inserted.centerline
    moved = built.reconstruction.patient.to_world(built.exposure.scene.box.to_world(true))
    errors: Floats = np.linalg.norm(moved - true, axis=1)
    return errors


def centerline_errors(built: Built) -> Floats:
    """Return the distance of each reconstructed point (N,) from the true needle, in the world, mm."""
    scene = built.exposure.scene
    true = scene.box.to_local(dense(scene.needles[0].points))
    return np.asarray(cKDTree(true).query(built.reconstruction.points)[0], dtype=np.float64)


def tip_error(built: Built) -> float:
    """Return the distance of the reconstructed tip from the true one, in the world, mm."""
    return float(np.linalg.norm(built.reconstruction.points[-1] - built.twin.inserted.centerline[-1]))
