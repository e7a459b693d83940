"""Curvatures that fibres in the needle read; errors of its pose do not change them."""

from dataclasses import dataclass

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.columns import MIN_SENSOR_MM
from needlefit.datasets.insertion import Insertion, find_pose
from needlefit.errors import refusal
from needlefit.inference.likelihood.nodes import make_nodes
from needlefit.inference.likelihood.observation import QUARTER_TURN, Observation, StatedErrors, whiten
from needlefit.inference.likelihood.observations import ObservationType

#: to both sides of a sensor, over which the simulated curvature is taken, mm
SENSOR_STEP_MM = MIN_SENSOR_MM


def append_sensors(insertion: Insertion, s: Floats) -> Floats:
    """Return beam coordinates `s` (K,), mm, and behind them three about each sensor of curvature."""
    if insertion.curvature is None:
        return s
    at = insertion.depth - insertion.curvature[:, 0]
    return np.concatenate([s, (at[:, None] + SENSOR_STEP_MM * np.array([-1.0, 0.0, 1.0])).ravel()])


def require_curvature(insertion: Insertion) -> None:
    """Raise DataError where an insertion that is fitted to by curvatures alone has none."""
    if insertion.curvature is None:
        raise refusal(f"""insertion `{insertion.id}` has no curvature
            expected: those of every insertion fitted to (`measurement = "curvature"`)
            fix: name their table under insertions.curvature""")


@dataclass(frozen=True)
class _Curvature(ObservationType):
    def observe(self, insertion: Insertion, errors: StatedErrors) -> Observation:
        """Return the observation of an insertion by its curvatures.

        A curvature is the second difference of the deflections about its sensor, over `SENSOR_STEP_MM`. In
        space those of a needle share an error of its roll. The places about a sensor are given deflections
        with the measured curvature.

        Raises DataError if no curvature was measured.
        """
        require_curvature(insertion)
        assert insertion.curvature is not None
        (_, *kappa, sd), count, step = insertion.curvature.T, errors.dataset.directions, SENSOR_STEP_MM
        sensors, s = len(sd), append_sensors(insertion, np.empty(0))
        shape = np.kron(np.ones(sensors), 0.5 * step**2 * np.array([1.0, 0.0, 1.0]))
        measured = np.column_stack([s, *(shape * np.repeat(part, 3) for part in kappa[:count])])
        # an error of the roll turns all curvatures alike
        turned = insertion.roll_sd * (QUARTER_TURN[:count, :count] @ kappa[:count]).ravel()
        cov = np.diag(np.tile(sd**2, count)) + np.outer(turned, turned)
        second = np.kron(np.eye(count * sensors), np.array([1.0, -2.0, 1.0]) / step**2)
        free, nothing = np.empty((len(cov), 0)), np.empty((0, len(cov)))
        whitening, log_norm = whiten(cov, free)
        pose = find_pose(errors.dataset.pose, insertion)
        nodes = make_nodes(insertion, s, errors.likelihood.depths, bevel=errors.bevels_vary)
        return Observation(measured, cov, free, free, whitening @ second, log_norm, pose, nodes, nothing)


CURVATURE = _Curvature("curvature")
