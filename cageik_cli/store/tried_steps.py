"""What a run has tried on some frames of its clip, so that it advises only what helps."""

from dataclasses import dataclass
from enum import StrEnum

import h5py

from cageik_cli.store.hdf5_fields import parse_record, read_json_attr, read_optional_record
from cageik_cli.util.errors import FormatError

MAX_HELPFUL_SHARE = 0.95
"""A step helps if it leaves at most this share of the error: less is within what frames differ."""

MAX_SMOOTH_SHARE = 0.75
"""The same of smoothing, where what is hidden on purpose stands for what is missing elsewhere."""


class Step(StrEnum):
    """A step that may lower the error of a clip, or raise it.

    `TORN` rejects outliers, too, of a surface that is torn: its error is that of what is kept.
    """

    ROBUST = "robust"
    TORN = "robust, torn"
    FIT = "fit"
    ROBUST_FIT = "robust, fit"
    SMOOTH = "smooth"


@dataclass(frozen=True, slots=True)
class TriedStep:
    """A step that was tried: the errors of some frames without and with it.

    Attributes
    ----------
    step : Step
        What was tried.
    before_percent, after_percent : float
        Root mean square over the frames that were measured, in percent of the diagonal.
    frames : int
        How many these are.
    """

    step: Step
    before_percent: float
    after_percent: float
    frames: int

    @property
    def has_helped(self) -> bool:
        """Whether the error was clearly smaller with the step."""
        most = MAX_SMOOTH_SHARE if self.step == Step.SMOOTH else MAX_HELPFUL_SHARE
        return self.before_percent > 0 and self.after_percent <= most * self.before_percent


@dataclass(frozen=True, slots=True)
class HiddenErrors:
    """Errors of vertices that were seen, and hidden on purpose as others are missing.

    Attributes
    ----------
    rms_percent, largest_percent : float
        In percent of the diagonal.
    frames : int
        In how many some were hidden.
    """

    rms_percent: float
    largest_percent: float
    frames: int


def read_hidden_errors(file: h5py.File) -> HiddenErrors | None:
    """Read the errors of vertices hidden on purpose; None if they were not measured."""
    found = read_optional_record(file, "hidden", HiddenErrors)
    if found is not None and not (
        min(found.rms_percent, found.largest_percent) >= 0 and found.frames > 0
    ):
        raise FormatError(
            "attribute `hidden` has an error below 0, or of no frame; extract it again"
        )
    return found


def read_tried_steps(file: h5py.File) -> tuple[TriedStep, ...]:
    """Read the steps that were tried; none if the result does not say."""
    if "tried" not in file.attrs:
        return ()
    held = read_json_attr(file, "tried", list)
    found: tuple[TriedStep, ...] = parse_record(tuple[TriedStep, ...], held, "tried")
    for one in found:
        if not (min(one.before_percent, one.after_percent) >= 0 and one.frames > 0):
            raise FormatError(
                "attribute `tried` has an error below 0, or of no frame; extract it again"
            )
    return found
