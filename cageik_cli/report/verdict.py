"""The verdict on a result: how good it is in one word, and the one step that would help most."""

from cageik_cli.captured.settings import AUTO_SMOOTHING
from cageik_cli.method.solve.regions import Cause
from cageik_cli.report.notes import MIN_DATA_PER_CAGE_VERTEX, has_outliers
from cageik_cli.store.result import Result, has_weights
from cageik_cli.util.messages import Hint, Said, Text, say

MAX_GOOD_RMS = 0.3
"""Percent of the diagonal; above this rms, a result is fair at best.

The bounds were chosen by looking at the worst frames of a dancer, a horse and a cartoon chicken
beside their input. At 0.16 and 2.4 % they look alike. At 0.6 and 6.4 % a hoof or a finger has
another shape, which is seen if one looks for it. At 0.64 and 8 % legs are visibly deformed.
"""

MAX_GOOD_DEVIATION = 3.0
"""Percent of the diagonal; above this largest deviation, a result is fair at best."""

MAX_FAIR_RMS = 0.75
"""Percent of the diagonal; above this rms, a result is poor."""

MAX_FAIR_DEVIATION = 7.0
"""Percent of the diagonal; above this largest deviation, a result is poor."""

MAX_ADVISED_VERTICES = 400
"""Vertices of a cage that are advised, at most: by hand, one poses fewer."""


def judge_quality(rms_percent: float, max_deviation_percent: float) -> str:
    """Return a key of `QUALITY_WORDS`; both errors are in percent of the diagonal."""
    if rms_percent <= MAX_GOOD_RMS and max_deviation_percent <= MAX_GOOD_DEVIATION:
        return "good"
    if rms_percent <= MAX_FAIR_RMS and max_deviation_percent <= MAX_FAIR_DEVIATION:
        return "fair"
    return "poor"


def suggest_step(result: Result, rms_percent: float, max_deviation_percent: float) -> Text | None:
    """Return the one step that would lower the error most and is not taken yet.

    None if there is none, or the error is far below what can be seen. Parameters are keywords in
    backticks, as in messages, and all that is to be given. Frames are rejected or smoothed only
    where vertices are outliers: quick motion is no fault.
    """
    if has_outliers(result) and not result.settings.get("robust"):
        return _repeat(say("`robust=True`"))
    if 2 * rms_percent <= MAX_GOOD_RMS and 2 * max_deviation_percent <= MAX_GOOD_DEVIATION:
        return None
    region, is_built = result.worst_region, _has_built_cage(result)
    cause = None if region is None else region.cause
    if cause == Cause.SMOOTHING:
        is_auto = result.settings["smooth"] == AUTO_SMOOTHING
        return None if is_auto else _repeat(Hint("smooth", AUTO_SMOOTHING))
    if cause == Cause.LOOSE_CAGE and not is_built:
        return _repeat("", ", without " + _name_cage_source(result) + ": a tighter cage is built")
    if result.fit is None and _allows_fit(result):
        if "binding" in result.sources:
            return say("bind again with `fit=FRAMES`, then extract with that `binding=`")
        return _repeat(say("`fit=True`"))
    if cause == Cause.SHARED_LOOP and is_built and isinstance(result.settings["rest_frame"], int):
        return _repeat(say("`rest_frame=auto`"), ", if limbs touch in the rest pose")
    return _suggest_vertices(result)


def _repeat(step: Said, condition: Said = "") -> Text:
    """Say how the run that made the result is repeated with a step; the result is replaced."""
    steps = "extract again with " + step + " " if step else "extract again with "
    return steps + say("`overwrite=True`") + condition


def _allows_fit(result: Result) -> bool:
    """Return whether the same run takes a fit, and has frames enough for it.

    It refuses one to data that are missing, and one that is not stored.
    """
    is_long = len(result.frames) - len(result.skipped) > 2
    return is_long and result.kept is None and has_weights(result)


def _has_built_cage(result: Result) -> bool:
    return "cage_vertices" in result.settings


def _name_cage_source(result: Result) -> Text:
    """Return the parameter by which the cage was given."""
    return say("`binding=`") if "binding" in result.sources else say("`cage=`")


def _suggest_vertices(result: Result) -> Text | None:
    """Return the advice of twice as many cage vertices, if the model has data for them."""
    data = len(result.rest.vertices) // MIN_DATA_PER_CAGE_VERTEX
    count = min(2 * len(result.cage.vertices), MAX_ADVISED_VERTICES)
    if count <= len(result.cage.vertices) or count > data:
        return None
    place = "" if _has_built_cage(result) else ", without " + _name_cage_source(result)
    return _repeat(Hint("vertices", count), place)
