"""A needle that follows tracked poses, and the running estimate of its moduli and bevel.

Poses act on the needle of the page as inputs, and are recorded. A pose that is stale, jumps, or cannot be the
needle's freezes needle and estimate. A jump freezes them until it is released on the page: a pose that stays
where it jumped to must not count as right after a while.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from needlefit.arrays import Floats, are_bounded
from needlefit.datasets.points import MAX_COORDINATE
from needlefit.errors import ConfigError, ModelError, NeedlefitError
from needlefit.geometry.frames import Frame, Placement, to_lps
from needlefit.imaging.registration.pairing import fit_kabsch
from needlefit.inference.forward_model import ParameterDraws
from needlefit.inference.tracking import (
    TipNoise,
    TrackedNeedle,
    TrackingEstimate,
    discount_estimate,
    estimate_parameters,
    make_prior_from_draws,
    make_prior_from_factors,
)
from needlefit.mechanics.shape import compute_positions
from needlefit.schemas.tracker import TrackerRecord
from needlefit.viewer.plans import find_placement
from needlefit.viewer.steering import Change, guide_number
from needlefit.viewer.trial import InteractiveTrial
from needlefit.viewer.trials import TrialRegistry

#: greatest deviation of a transform's columns from unit length and right angles; OpenIGTLink sends floats
MAX_ROTATION_ERROR = 1e-3
MIN_MARKER_SPREAD_MM = 1.0  #: markers that lie closer to a line than this determine no rotation
#: messages that come closer together count as so far apart when speed is judged: they come in bursts
MIN_INTERVAL_S = 0.05
#: smaller motions of base and guides are noise: each change of an input is recorded, and begins a new ray
MIN_MOVE_MM, MIN_TURN = 0.02, 2e-4
#: the needle follows a tip forward by steps of the first, and back from the second on: readings jitter
MIN_INSERTION_MM, WITHDRAWAL_MM = 0.05, 1.0
REST_S = 0.2  #: a needle that has not moved for so long is at rest: base and guides act at once
MAX_RECENT_POSES = 256  #: poses of a device that are kept for their mean
MAX_AXIS_SLOPE = 1.0  #: slope of a base or guide beyond which its z axis is not along the needle
TRACKING_GESTURE = -1_000_000  #: all poses are one gesture: they are undone together
UPDATE_ITERATIONS = 3  #: steps of Gauss-Newton after a reading; the next one goes on from there
BAND_DRAWS = 100  #: draws of an estimate, for band and plans


@dataclass(frozen=True)
class TrackedPose:
    """The pose of a device in C: position (mm), and its z axis, None where it has no direction."""

    position: Floats
    axis: Floats | None
    received: float


@dataclass
class TrackedDevice:
    pose: TrackedPose  #: the last one that was accepted
    sent: float
    jumped: bool = False
    fault: str = ""  #: why it freezes the estimate
    #: poses that it sent since it last acted on the needle
    recent: deque[TrackedPose] = field(default_factory=lambda: deque(maxlen=MAX_RECENT_POSES))


def register_tracker(record: TrackerRecord, placement: Placement) -> Frame:
    """Return the tracker's frame in RAS.

    ConfigError if the matrix is not a rigid motion, or the markers lie on a line.
    """
    if record.tracker_to_ras is not None:
        rows = np.array(record.tracker_to_ras)
        if not is_rigid(rows):
            raise ConfigError(
                "tracker_to_ras is not a rigid motion",
                expected="four rows: rotation and shift in mm, then [0, 0, 0, 1]; no scale, no reflection",
            )
        return Frame.from_rows(rows[:3])
    tracker = np.array([marker.tracker_mm for marker in record.markers])
    world = np.array([marker.world_mm for marker in record.markers])
    for points in (tracker, world):
        spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) / math.sqrt(len(points))
        if spread[1] < MIN_MARKER_SPREAD_MM:
            raise ConfigError("the markers lie on a line", expected="three or more that span a triangle")
    ras = to_lps(placement.patient.to_local(world), "RAS")
    return fit_kabsch(tracker, ras, np.ones(len(tracker)))


def measure_registration_error(record: TrackerRecord, frame: Frame, placement: Placement) -> float | None:
    """Return the root mean square distance of registered markers, mm; None without markers."""
    if not record.markers:
        return None
    ras = frame.to_world([marker.tracker_mm for marker in record.markers])
    known = placement.patient.to_local([marker.world_mm for marker in record.markers])
    return float(np.sqrt(np.mean(np.sum((to_lps(ras, "RAS") - known) ** 2, axis=1))))


def is_rigid(matrix: Floats) -> bool:
    """Whether a (4, 4) array is a rotation and a shift."""
    if matrix.shape != (4, 4) or not are_bounded(matrix, MAX_COORDINATE):
        return False
    rotation = matrix[:3, :3]
    square = np.abs(rotation.T @ rotation - np.eye(3)).max() < MAX_ROTATION_ERROR
    return bool(square and np.linalg.det(rotation) > 0 and np.allclose(matrix[3], [0, 0, 0, 1]))


class TrackedTrial:
    """The one needle of all windows, moved by tracked poses, and the estimate of its parameters.

    The windows of `trials` share one needle from then on.
    """

    def __init__(self, record: TrackerRecord, trials: TrialRegistry) -> None:
        self.record, self._trials = record, trials
        self._trial = trials.share()
        self.noise = TipNoise(record.tip_sd_mm, record.depth_sd_mm, record.shift_sd_mm, record.slope_sd)
        roles = record.devices
        guides = {name: f"guide {n}" for n, name in enumerate(roles.guides, start=1)}
        self.roles = {roles.tip: "tip", roles.base: "base", roles.stage: "stage", **guides}
        self.number = 0  #: counts changes of what `status` returns
        self.peers = self.ignored = 0  #: connections, and messages that were not taken
        self.devices: dict[str, TrackedDevice] = {}
        self._delay = math.inf
        self._refused = self._frozen = self._unplaced = ""
        self._travel_from = np.zeros(3)
        self._inserted_at = -math.inf
        self.placement = find_placement(self._trial.viewed_scene)
        self._begin()

    @property
    def trial(self) -> InteractiveTrial:
        """The needle that is followed; another one, begun anew, once the windows have changed theirs."""
        if self._trial is not self._trials.share():
            self._begin()
        return self._trial

    def _begin(self) -> None:
        self._trial = self._trials.share()
        viewed_scene, self._unplaced = self._trial.viewed_scene, ""
        try:
            self.placement = find_placement(viewed_scene)
        except ConfigError as error:
            self._unplaced = error.what
        self._tracker = register_tracker(self.record, self.placement)
        self.registration_error = measure_registration_error(self.record, self._tracker, self.placement)
        spread, scene, between = viewed_scene.spread, self._trial.scene, self.record.prior
        if spread is not None and len(spread) > 1:  # the posterior of the run shown
            self._own_prior = make_prior_from_draws(spread.mu, spread.bevel, self.noise)
        else:
            strength, _ = scene.rules.bevel_strength(scene.steps[0].bevel)
            factors = (between.modulus_factor, between.bevel_factor)
            self._own_prior = make_prior_from_factors(scene.tissue.mu, strength, factors, self.noise)
        self._normal = np.random.default_rng(0).standard_normal((BAND_DRAWS, len(self._own_prior.theta)))
        self.forget()
        self.release()

    def forget(self) -> None:
        """Return to the prior."""
        self.estimate = self._prior = self._own_prior
        self._readings: list[tuple[float, float]] = []
        self._insertion: TrackedNeedle | None = None
        self._deepest = self._held_at = self._trial.steering.now.step.depth
        self.number += 1

    def release(self) -> None:
        """Accept the poses that come next, wherever they are; the travel of the stage begins anew."""
        self.devices = {}
        self._delay = math.inf
        self.number += 1

    def count_peers(self, change: int) -> None:
        """Note that a connection was made or lost; the delay of the next sender's clock is measured anew."""
        self.peers += change
        self._delay = math.inf
        self.number += 1

    def to_ras(self, points: Floats) -> Floats:
        """Return points (K, 2) of C in RAS, mm."""
        return to_lps(self.placement.to_patient(points), "RAS")

    def to_ras_direction(self, vector: Sequence[float]) -> Floats:
        """Return a direction (3,) given in C in RAS."""
        world = self.placement.frame.rotation @ np.asarray(vector)
        return to_lps(world @ self.placement.patient.rotation, "RAS")

    def _to_c(self, ras: Floats) -> Floats:
        """Return RAS points (K, 3) in C."""
        return self.placement.frame.to_local(self.placement.patient.to_world(to_lps(ras, "RAS")))

    def take(self, name: str, matrix: Floats, sent: float, received: float, *, directed: bool = True) -> bool:
        """Take the pose (4, 4) of a device in the tracker's frame; returns whether it is one that is known.

        It was sent at a time by the clock of its sender, s (0: not stated), and received by the clock here.
        `directed`: its rotation means something.
        """
        role = self.roles.get(name)
        if role is None or not is_rigid(matrix):
            self.ignored += 1
            return False
        ends = self._to_c(self._tracker.to_world([matrix[:3, 3], matrix[:3, 3] + matrix[:3, 2]]))
        pose = TrackedPose(ends[0], ends[1] - ends[0] if directed else None, received)
        known = self.devices.get(role)
        # Two clocks may differ: what a message took longer than the fastest one is its age.
        self._delay = min(self._delay, received - sent) if sent else self._delay
        if sent and received - sent - self._delay > self.record.max_age_s:
            return True  # it waited on its way: as if it had not come
        if known is None:
            self.devices[role] = known = TrackedDevice(pose, sent)
            self.number += 1
            if role == "stage":  # its travel counts from here
                step = self._trial.steering.now.step
                self._travel_from = pose.position - [step.depth, step.controls.base_y, 0.0]
        elif sent and sent < known.sent:
            return True  # overtaken by a newer one
        elif not known.jumped:
            elapsed = sent - known.sent if sent and known.sent else received - known.pose.received
            # a device that was silent for long may not be anywhere, either
            elapsed = min(max(elapsed, MIN_INTERVAL_S), 2 * self.record.max_age_s)
            distance = float(np.linalg.norm(pose.position - known.pose.position))
            known.jumped = distance > self.record.max_speed_mm_s * elapsed
            if known.jumped:
                self.number += 1
            else:
                known.pose, known.sent = pose, sent
                known.recent.append(pose)
        known.fault = self._find_fault(role, known)
        return True

    def _find_fault(self, role: str, known: TrackedDevice) -> str:
        """Return why a device freezes the estimate, however fresh its pose is; empty if it does not."""
        pose = known.pose
        if known.jumped:
            return f"{role} jumped: it moved faster than {self.record.max_speed_mm_s:g} mm/s"
        if role == "tip" and abs(pose.position[2]) > self.record.max_out_of_plane_mm:
            return f"the tip is {abs(pose.position[2]):.1f} mm out of the bending plane"
        if role not in ("tip", "stage") and pose.axis is not None:
            x, y, _ = pose.axis
            if x <= 0 or abs(y) >= MAX_AXIS_SLOPE * x:
                return f"the z axis of {role} does not point along the needle"
        return ""

    def find_frozen(self, now: float) -> str:
        """Return why needle and estimate do not follow; empty if they do, or nothing was tracked yet."""
        for role, known in self.devices.items():
            if known.fault:
                return known.fault
            if now - known.pose.received > self.record.max_age_s:
                return f"{role} is stale: no transform for more than {self.record.max_age_s:g} s"
        return self._unplaced or self._refused

    def advance(self, now: float) -> bool:
        """Move the needle to the tracked poses, and note the tip's reading; returns whether to estimate."""
        trial = self.trial
        self._refused = ""
        frozen = self.find_frozen(now)
        if not frozen and self.devices:
            try:
                if changes := self._list_changes(trial, now):
                    trial.act(changes, TRACKING_GESTURE)
            except (NeedlefitError, OSError) as error:
                self._refused = frozen = error.what if isinstance(error, NeedlefitError) else str(error)
        if frozen != self._frozen:
            self._frozen = frozen
            self.number += 1
        return not frozen and self._note_reading(trial)

    def _list_changes(self, trial: InteractiveTrial, now: float) -> list[Change]:
        steering, step, shape = trial.steering, trial.steering.now.step, trial.steering.now.shape
        poses = {role: known.pose for role, known in self.devices.items()}
        # Every change of what holds the needle begins a new ray where it then cuts on: while it goes in there
        # is at most one per constraint spacing, or a jittering tracker would make the path long. It is the
        # mean of the poses since the one before, in which the errors of a reading partly cancel.
        goes_in, held = now - self._inserted_at < REST_S, dict(poses)
        for role, known in self.devices.items():
            if goes_in and len(known.recent) > 1:
                axes = [pose.axis for pose in known.recent if pose.axis is not None]
                position = np.mean([pose.position for pose in known.recent], axis=0)
                held[role] = TrackedPose(position, np.mean(axes, axis=0) if axes else None, now)
        wanted: list[tuple[str, int | None, float, float]] = []  # input, item, value, value now
        depth = None
        if "tip" in poses:  # a bent needle's tip lags behind its depth
            depth = poses["tip"].position[0] + step.depth - compute_positions(shape, shape.x[-1:])[0, 0]
        if "stage" in poses:
            depth = poses["stage"].position[0] - self._travel_from[0]
            wanted = [
                ("base_y_mm", None, held["stage"].position[1] - self._travel_from[1], step.controls.base_y)
            ]
        if "base" in poses:
            depth = trial.scene.needle.length + poses["base"].position[0]
            wanted = [("base_y_mm", None, held["base"].position[1], step.controls.base_y)]
            if (axis := held["base"].axis) is not None:
                wanted.append(("base_slope", None, axis[1] / axis[0], step.controls.base_slope))
        guides = {guide_number(guide, steering.names): guide for guide in step.controls.guides}
        for item in range(1, len(self.record.devices.guides) + 1):
            if (pose := held.get(f"guide {item}")) is None:
                continue
            guide = guides.get(item)
            x, y, slope = (guide.x, guide.y, guide.slope) if guide else (math.inf, math.inf, 0.0)
            wanted.append(("guide_x_mm", item, pose.position[0], x))
            wanted.append(("guide_y_mm", item, pose.position[1], y))
            if pose.axis is not None and slope is not None:
                wanted.append(("guide_slope", item, pose.axis[1] / pose.axis[0], slope))
        changes = [
            Change(name, item, float(value))
            for name, item, value, present in wanted
            if abs(value - present) >= (MIN_TURN if name.endswith("slope") else MIN_MOVE_MM)
        ]
        if changes and goes_in and abs(step.depth - self._held_at) < trial.scene.rules.spacing:
            changes = []
        elif changes:
            self._held_at = step.depth
        if changes or not goes_in:
            for known in self.devices.values():
                known.recent.clear()
        if depth is not None:
            depth = min(max(float(depth), 0.0), steering.reach())
            moved = depth - step.depth
            if moved >= MIN_INSERTION_MM or (moved < 0 and (depth == 0.0 or moved <= -WITHDRAWAL_MM)):
                self._inserted_at = now
                changes.append(Change("depth_mm", None, depth))
        return changes

    def _note_reading(self, trial: InteractiveTrial) -> bool:
        """Note the tip where it has cut a further constraint spacing; returns whether it has."""
        now, known, steering, scene = trial.steering.now, self.devices.get("tip"), trial.steering, trial.scene
        depth = now.step.depth
        if depth < self._deepest - WITHDRAWAL_MM:
            if self._readings:
                self._prior, self._readings = discount_estimate(self.estimate, self._own_prior), []
            self._deepest = depth
        free = now.step.controls.tip is None
        if known is None or not free or depth < self._deepest + scene.rules.spacing - MIN_INSERTION_MM:
            return False
        # The equations know the deflection at the beam coordinate, a tracker the place of the point.
        beside = now.shape.tip_lateral - float(now.shape.u[-1])
        self._readings.append((depth, float(known.pose.position[1]) - beside))
        self._deepest, path = depth, steering.input_path()
        self._insertion = TrackedNeedle(scene.needle, now.tissue, path, scene.rules, steering.first_cell)
        return True

    def compute_estimate(self) -> TrackingEstimate | None:
        """Return the estimate from all readings; it can run in a thread, and changes nothing."""
        assert self._insertion is not None
        given = (np.array(self._readings), self._prior, self.noise, self.estimate, UPDATE_ITERATIONS)
        return estimate_parameters(self._insertion, *given)

    def apply(self, found: TrackingEstimate | None, trial: InteractiveTrial) -> None:
        """Give the needle, its band and its plans the parameters of an estimate."""
        self.number += 1
        # The user may have returned to the prior, or opened another needle, while it was computed.
        if found is None or self._insertion is None or trial is not self.trial:
            return
        self.estimate = found
        drawn = found.transform(self._normal)
        shape = np.tile(trial.steering.now.tissue.shape, (len(drawn), 1, 1))
        spread = ParameterDraws(drawn[:, :-1], shape, drawn[:, -1])
        *mu, strength = np.exp(found.theta).tolist()
        changes = [Change("mu_pa", n, 1e6 * value) for n, value in enumerate(mu, start=1)]
        if trial.scene.rules.path_angle:
            changes.append(Change("cut_angle_throughout_deg", None, math.degrees(strength)))
        else:
            changes.append(Change("offset_throughout_mm", None, strength))
        try:
            trial.act(changes, TRACKING_GESTURE)
        except (ModelError, OSError):
            return  # the needle keeps the parameters that it has; the estimate is shown
        trial.viewed_scene = replace(trial.viewed_scene, spread=spread)

    def status(self, now: float) -> dict[str, Any]:
        """Return what the page and listeners are to know, ready for JSON."""
        low, median, high = self.estimate.interval()
        strength = "cut_angle_deg" if self.trial.scene.rules.path_angle else "offset_mm"
        factor = math.degrees(1.0) if strength == "cut_angle_deg" else 1.0
        rows = np.column_stack([low, median, high])
        tip = self.devices.get("tip")
        return {
            "kind": "tracking",
            "research_use": True,
            "peers": self.peers,
            "ignored": self.ignored,
            "frozen": self.find_frozen(now),
            "devices": {role: round(now - known.pose.received, 1) for role, known in self.devices.items()},
            "tip": None if tip is None else np.round(tip.pose.position, 3).tolist(),
            "readings": self.estimate.readings,
            "mu_pa": np.round(1e6 * rows[:-1], 1).tolist(),
            strength: np.round(factor * rows[-1], 5).tolist(),
            "registration_rms_mm": self.registration_error,
        }
