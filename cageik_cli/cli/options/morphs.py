"""Options of files with morph targets."""

from pathlib import Path

import click

from cageik_cli.cli.options.group import OptionGroup
from cageik_cli.cli.options.limits import LimitValue, PercentType
from cageik_cli.formats.settings import DEFAULT_MORPHS, MAX_MORPHS, MorphSettings

MORPH_SUFFIX = ".glb"


class ToleranceType(PercentType):
    """Percent of the diagonal, above zero, with or without the sign."""

    name = "percent"
    noun = "a tolerance"
    expected = "0.01%, of the diagonal"


def make_morph_settings(morph_count: int | None, tolerance: LimitValue | None) -> MorphSettings:
    """Make the settings of what was typed."""
    if tolerance is not None and tolerance.value == 0:
        raise click.UsageError(
            "--tolerance is 0, expected a percentage above zero, such as 0.01%: positions are in "
            "single precision"
        )
    return MorphSettings(morph_count, None if tolerance is None else float(tolerance.value))


MORPH_OPTIONS = OptionGroup(
    "morphs",
    make_morph_settings,
    click.option(
        "--morphs",
        "morph_count",
        type=click.IntRange(2, MAX_MORPHS),
        help=f"Write at most this number of morph targets ({MORPH_SUFFIX}).  [default: "
        f"{DEFAULT_MORPHS}, or {MAX_MORPHS} with --tolerance]",
    ),
    click.option(
        "--tolerance",
        type=ToleranceType(),
        help="Write as few morph targets as bring every vertex in every frame this near, in "
        f"percent of the diagonal, such as 0.01%; fail if that is impossible ({MORPH_SUFFIX}).",
    ),
)


def check_morph_usage(options: str, is_given: bool, out: Path) -> None:
    """Refuse options of morph targets for another format as wrong usage."""
    if is_given and out.suffix.lower() != MORPH_SUFFIX:
        raise click.UsageError(
            f"{options} apply to {MORPH_SUFFIX} files, and the output is {out}; leave them out, "
            f"or write {MORPH_SUFFIX}"
        )
