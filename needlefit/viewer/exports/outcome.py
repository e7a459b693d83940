"""Where a recording ends, once it is carried out again."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

from needlefit.geometry.placement import Placement
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.session import Moment
from needlefit.viewer.hand.steering import Steering
from needlefit.viewer.recording.log import Recording
from needlefit.viewer.recording.replay import begin, replay


@dataclass(frozen=True)
class Outcome:
    """A recording, carried out.

    Attributes
    ----------
    recording : Recording
    steering : Steering
        Its needle, as it stands at the end.
    off : float
        How far the tip came to stand from where the recording says, at most, mm; 0: the same bits.
    """

    recording: Recording
    steering: Steering
    off: float

    @property
    def title(self) -> str:
        """The scene's, or else its name."""
        return self.recording.head.scene.title or self.recording.head.subject

    @property
    def placement(self) -> Placement | None:
        """Where a measured needle lies; None of a scene, which says so itself."""
        placement = self.recording.head.placement
        return None if placement is None else Placement.from_record(placement)

    @property
    def moment(self) -> Moment:
        """The needle at the end."""
        return self.steering.now

    @property
    def scene(self) -> Scene:
        """The scene, with the tissue and the inputs that the needle has at the end."""
        return replace(self.steering.scene, tissue=self.moment.tissue, steps=(self.moment.step,))


def carry_out(recording: Recording) -> Outcome:
    """Return where a recording ends.

    Raises
    ------
    ConfigError, DataError
        As `begin` and `replay`.
    """
    steering = begin(recording)
    off = max(replayed.off for replayed in replay(recording, steering))
    return Outcome(recording, steering, off)


def timed(recording: Recording) -> Iterator[tuple[float, Moment]]:
    """Yield every moment of a recording with its time, s."""
    return ((replayed.time, replayed.moment) for replayed in replay(recording))


def duration(recording: Recording) -> float:
    """Return how long a recording lasts, s."""
    return recording.steps[-1].time if recording.steps else 0.0
