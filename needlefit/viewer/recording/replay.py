"""A recording carried out again."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from needlefit.errors import DataError, ModelError
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.session import Moment
from needlefit.viewer.hand.steering import Steering
from needlefit.viewer.recording.log import Recorded, Recording


@dataclass(frozen=True)
class Replayed:
    """One step of a recording, carried out again.

    Attributes
    ----------
    recorded : Recorded or None
        What was recorded; None of the needle at first contact.
    moment : Moment
        The needle after it.
    """

    recorded: Recorded | None
    moment: Moment

    @property
    def time(self) -> float:
        """Since the recording began, s."""
        return self.recorded.time if self.recorded else 0.0

    @property
    def off(self) -> float:
        """How far the tip stands from where the recording says, mm; 0: the same bits."""
        return abs(float(self.moment.shape.u[-1]) - self.recorded.deflection) if self.recorded else 0.0


def begin(recording: Recording) -> Steering:
    """Return the needle of a recording at first contact.

    Raises
    ------
    ConfigError
        If the model does not take its scene.
    """
    return Steering(Scene.from_record(recording.head.scene, recording.where), recording.head.first_cell_mm)


def replay(recording: Recording, steering: Steering | None = None) -> Iterator[Replayed]:
    """Yield the needle at first contact and after every step of a recording.

    Parameters
    ----------
    recording : Recording
    steering : Steering, optional
        The needle that carries it out, which stands at first contact; by default a new one.

    Raises
    ------
    DataError
        If a step cannot be carried out; it was recorded by another version, or changed since.
    """
    steering = steering or begin(recording)
    last = last_returns(recording.steps)
    yield Replayed(None, steering.now)
    for recorded in recording.steps:
        try:
            moment = steering.apply(recorded.changes)
        except ModelError as error:
            raise DataError(
                f"step {recorded.number} cannot be carried out: {error.what}",
                where=f"{recording.where}, line {recorded.line}",
                expected=error.expected,
                mend=f"it was recorded by needlefit {recording.head.needlefit}; replay it with that version",
            ) from error
        keep_for_returns(recorded, last, steering.keep, steering.forget)
        yield Replayed(recorded, moment)


def last_returns(steps: Sequence[Recorded]) -> dict[int, int]:
    """Return to which steps the needle returns, and the number of the last step that does."""
    return {int(c.value): step.number for step in steps for c in step.changes if c.name == "return_to"}


def keep_for_returns(
    recorded: Recorded, last: dict[int, int], keep: Callable[[], None], forget: Callable[[int], None]
) -> None:
    """Keep the needle as it stands after a step if a later one returns to it; forget what none returns to."""
    if recorded.number in last:
        keep()
    for change in recorded.changes:
        if change.name == "return_to" and last[int(change.value)] == recorded.number:
            forget(int(change.value))
