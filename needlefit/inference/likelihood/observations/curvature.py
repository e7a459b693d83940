"""Curvatures that fibres in the needle read; errors of its pose do not change them."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.columns import MIN_SENSOR_MM
from needlefit.datasets.insertion import Dataset, Insertion, Pose, find_pose
from needlefit.datasets.noise import NoiseFloor
from needlefit.errors import DataError
from needlefit.geometry.curves import Quantity, compare_curves
from needlefit.inference.likelihood.compared_points import ComparedPoints
from needlefit.inference.likelihood.nodes import make_nodes
from needlefit.inference.likelihood.observation import Observation, whiten
from needlefit.inference.likelihood.observations import ObservationType, TrueNeedle
from needlefit.inference.likelihood.pose_errors import QUARTER_TURN, turn_about_x
from needlefit.inference.likelihood.stated_errors import StatedErrors
from needlefit.metrics import compute_metrics
from needlefit.schemas.base import Compared

INTEGRATION_POINTS = 1001  #: number of points of the integration from the clamped end to the tip
#: distance (mm) to both sides of a sensor over which the simulated curvature is taken
SENSOR_STEP_MM = MIN_SENSOR_MM


#: weights of three deflections about a sensor that give its curvature, 1/mm
SECOND_DIFFERENCE = np.array([[1.0, -2.0, 1.0]]) / SENSOR_STEP_MM**2
FLOOR_DRAWS = 200  #: number of draws of readings, of whose errors the noise floor is the mean


def surround_sensors(insertion: Insertion) -> Floats:
    """Return the beam coordinates (3 n,), mm, about the n sensors of an insertion; none without any."""
    places = np.empty(0) if insertion.curvature is None else insertion.depth - insertion.curvature[:, 0]
    return surround(places)


def surround(places: Floats) -> Floats:
    """Return beam coordinates (3 K,), mm: the three about each place (K,) that give its curvature."""
    return (places[:, None] + SENSOR_STEP_MM * np.array([-1.0, 0.0, 1.0])).ravel()


def combine_readings(pose: Pose, insertion: Insertion) -> Mapping[Quantity, tuple[Floats, Floats]]:
    """Return what readings are compared by: the x (K,), mm, and the combinations (K, n) of n curvatures.

    They are themselves in 1/m, and, where a sensor lies before the entry and the pose is known, entry and
    tip, mm, to which they lead from the base, or from a guide: see `integrate_sensors`. The base, or guide,
    is no farther from the first sensor than that is from the last: beyond, readings would hardly tell.
    """
    assert insertion.curvature is not None
    from_tip = insertion.curvature[:, 0]
    combined: dict[Quantity, tuple[Floats, Floats]] = {
        "curvatures": (insertion.depth - from_tip, 1e3 * np.eye(len(from_tip)))
    }
    unmeasured = insertion.depth - max(from_tip) - find_clamp(insertion)
    is_within = unmeasured <= np.ptp(from_tip) and max(from_tip) > insertion.depth
    if is_within and find_pose(pose, insertion) == "known":
        weights = integrate_sensors(insertion)
        combined["integrated"] = np.array([0.0, insertion.depth]), np.vstack([0 * weights, weights])
    return combined


def compare_sensors(pose: Pose, insertion: Insertion, compared: Compared) -> tuple[ComparedPoints, ...]:
    """Return what a curve is compared with: the readings of the sensors, and the tip to which they lead."""
    require_curvature(insertion)
    assert insertion.curvature is not None
    s, known_pose = surround_sensors(insertion), find_pose(pose, insertion)
    second = np.kron(np.eye(len(insertion.curvature)), SECOND_DIFFERENCE)
    return tuple(
        ComparedPoints(
            s,
            np.column_stack([x, combine @ insertion.curvature[:, 1:3]]),
            known_pose,
            compared,
            quantity,
            combine @ second,
        )
        for quantity, (x, combine) in combine_readings(pose, insertion).items()
    )


def find_clamp(insertion: Insertion) -> float:
    """Return the beam coordinate, mm, of the clamped end: the base, or a guide."""
    distance = insertion.guide_distance
    return insertion.depth - insertion.needle.length if distance is None else -distance


def integrate_sensors(insertion: Insertion) -> Floats:
    """Return the weights (n,), mm^2, by which curvatures lead from the clamped end to the tip's deflection.

    Curvature is 0 at the tip, linear between sensors, and goes on before the first, where the needle is free.
    """
    assert insertion.curvature is not None
    clamp = find_clamp(insertion)
    order = np.argsort(-insertion.curvature[:, 0])
    places = np.append(insertion.depth - insertion.curvature[order, 0], insertion.depth)
    s = np.linspace(clamp, insertion.depth, INTEGRATION_POINTS)
    unit = np.eye(len(places))[:, :-1]  # of each sensor; the tip has none
    curves = np.array([np.interp(s, places, curve) for curve in unit.T])  # (n, S)
    if len(order) > 1:
        before = s < places[0]
        beyond = (places[0] - s[before]) / (places[1] - places[0])
        curves[0, before], curves[1, before] = 1 + beyond, -beyond
    weights = np.empty(len(order))
    weights[order] = np.trapezoid((insertion.depth - s) * curves, s)
    return weights


def require_curvature(insertion: Insertion) -> None:
    """Raise DataError where an insertion that is fitted to by curvatures alone has none."""
    if insertion.curvature is None:
        raise DataError(
            f"insertion `{insertion.id}` has no curvature",
            expected='those of every insertion fitted to (`measurement = "curvature"`)',
            fix="name their table under insertions.curvature",
        )


@dataclass(frozen=True)
class _Curvature(ObservationType):
    def select_points(
        self, pose: Pose, drop: float, insertion: Insertion, stations: int, compared: Compared
    ) -> ComparedPoints:
        """Return the readings, whatever `stations`."""
        return compare_sensors(pose, insertion, compared)[0]

    def take_alone(self, dataset: Dataset, insertion: Insertion) -> tuple[Dataset, Insertion]:
        """Return the insertion with its curvatures alone."""
        return dataset, replace(insertion, observation=self.name, tip=None, observation_values={})

    def compare(self, dataset: Dataset, insertion: Insertion) -> tuple[ComparedPoints, ...]:
        """Return the readings, and the tip to which they lead."""
        return compare_sensors(dataset.pose, insertion, dataset.compared)

    def estimate_floor(self, dataset: Dataset, insertion: Insertion, rng: np.random.Generator) -> NoiseFloor:
        """Return the mean errors of readings that are made again."""
        assert insertion.curvature is not None
        read, floors = insertion.curvature, dict[str, float]()
        errors = read[:, 3:] * rng.standard_normal((FLOOR_DRAWS, len(read), 2))  # (B, n, 2)
        for quantity, (x, combine) in combine_readings(dataset.pose, insertion).items():
            still = np.pad(x[:, None], ((0, 0), (0, 2)))
            again = still + np.pad(combine @ errors, ((0, 0), (0, 0), (1, 0)))
            errors_of_draws = [
                compute_metrics(compare_curves(noisy, still, dataset.compared, quantity)) for noisy in again
            ]
            floors |= {
                name: float(np.mean([errors_of_draw[name] for errors_of_draw in errors_of_draws]))
                for name in errors_of_draws[0]
            }
        return floors

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
        sensors, s = len(sd), surround_sensors(insertion)
        shape = np.kron(np.ones(sensors), 0.5 * step**2 * np.array([1.0, 0.0, 1.0]))
        measured = np.column_stack([s, *(shape * np.repeat(part, 3) for part in kappa[:count])])
        # an error of the roll turns all curvatures alike
        turned = insertion.roll_sd * (QUARTER_TURN[:count, :count] @ kappa[:count]).ravel()
        cov = 1e6 * (np.diag(np.tile(sd**2, count)) + np.outer(turned, turned))  # 1/m^2
        second = np.kron(np.eye(count * sensors), 1e3 * SECOND_DIFFERENCE).astype(np.float64)
        free, nothing = np.empty((len(cov), 0)), np.empty((0, len(cov)))
        whitening, log_norm = whiten(cov, free)
        pose = find_pose(errors.dataset.pose, insertion)
        nodes = make_nodes(insertion, s, errors.likelihood.depths, bevel=errors.bevels_vary)
        return Observation(
            measured, cov, free, free, whitening @ second, log_norm, pose, nodes, nothing, operator=second
        )

    def measure(self, dataset: Dataset, insertion: Insertion, needle: TrueNeedle) -> Insertion:
        """Return the insertion with what its sensors read of a simulated needle."""
        assert insertion.curvature is not None
        s, *_, sd = insertion.curvature.T
        (roll,) = insertion.roll_sd * needle.draw(1)
        points = turn_about_x(needle.read(surround_sensors(insertion)), float(roll))
        kappa = np.diff(points[:, 1:].reshape(-1, 3, 2), n=2, axis=1)[:, 0] / SENSOR_STEP_MM**2
        read = np.column_stack([s, kappa + sd[:, None] * needle.draw(*kappa.shape), sd])
        if insertion.observation == self.name:  # its points are what the sensors lead to
            insertion = insertion.with_points(needle.read(insertion.measure_arc("space")))
        return replace(insertion, curvature=read)


CURVATURE = _Curvature("curvature", is_curve=False, has_tip=False)
