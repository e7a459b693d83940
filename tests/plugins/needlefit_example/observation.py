"""An observation: the needle in an ultrasound image, of which the first 10 mm are hidden."""

from dataclasses import dataclass

from needlefit.inference.likelihood.observation import complete_observation
from needlefit.inference.likelihood.observations import ObservationType
from needlefit.inference.likelihood.pose_errors import list_pose_modes, split_pose_modes
from needlefit.inference.likelihood.stated_errors import points_covariance

HIDDEN_MM = 10.0


@dataclass(frozen=True)
class Ultrasound(ObservationType):
    def observe(self, insertion, errors):
        along = insertion.measure_arc(errors.dataset.compared)
        seen = along > HIDDEN_MM
        s = along[seen] * insertion.depth / along[-1]
        measured = insertion.points[seen, : 1 + errors.dataset.directions]
        modes, sds = list_pose_modes(insertion, errors, measured)
        pose, free = split_pose_modes(insertion, modes, sds)
        covariance = points_covariance(s, errors.noise)
        return complete_observation(insertion, errors, s, measured, covariance, pose, free)


ULTRASOUND = Ultrasound("ultrasound")
