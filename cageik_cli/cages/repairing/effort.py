"""How much work a repair may do: counted, not timed, so that the same cage always ends alike."""

from dataclasses import dataclass

TANGLE_WORK, TANGLE_FACE_WORK = 2000.0, 50.0
"""Work of a search for crossing faces: for each search, and for each face in it."""

SAMPLE_FACE_WORK, SAMPLE_FACES = 0.03, 100
"""Work of the side and the distance of a sample: for each face of the cage, and so many more."""


@dataclass(slots=True)
class Effort:
    """The work that is left, about microseconds of one processor.

    Attributes
    ----------
    left : float
        Negative if the last piece of work was larger than what was left.
    """

    left: float

    @property
    def is_spent(self) -> bool:
        """Return whether no further piece of work may begin."""
        return self.left <= 0

    def spend(self, amount: float) -> None:
        """Count work of another kind."""
        self.left -= amount

    def spend_on_tangle(self, faces: int) -> None:
        """Count a search for crossings among faces."""
        self.left -= TANGLE_WORK + TANGLE_FACE_WORK * faces

    def spend_on_samples(self, samples: int, faces: int) -> None:
        """Count the measurement of samples in a cage of so many faces."""
        self.left -= SAMPLE_FACE_WORK * samples * (faces + SAMPLE_FACES)
