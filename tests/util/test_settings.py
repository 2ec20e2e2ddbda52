"""Settings that are declared once: what is allowed, what is recorded, and what options follow."""

from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Literal

import click
import numpy as np
import pytest
from click.testing import CliRunner

from cageik_cli.cli.command import GroupedCommand
from cageik_cli.cli.options.group import OptionGroup, list_options
from cageik_cli.formats.settings import ClipSettings
from cageik_cli.util.errors import SettingError
from cageik_cli.util.settings import (
    HelpGroup,
    Setting,
    check_settings,
    declare_group,
    declare_setting,
    describe_settings,
    list_meanings,
    repeat_setting,
    show_settings,
)


@dataclass(frozen=True, slots=True)
class Paint:
    """Settings of each kind."""

    layers: int = declare_setting(2, "Layers.", name="layers", meaning="how many", minimum=1)
    gloss: float | Literal["auto"] | None = declare_setting(
        None, "Gloss.", name="paint_gloss", above=0, word="auto", expected="a number"
    )
    colour: str = declare_setting("red", "Colour.", choices=("red", "blue"))
    share: float = declare_setting(
        0.5, "Share.", is_share=True, maximum=1, minimum=0, refusal="{percent:g} % is no share"
    )
    matt: bool = declare_setting(
        False,
        "Matt.",
        name="matt",
        is_recorded_unset=False,
        excludes=(("gloss", "`matt=True` and `gloss={gloss:g}` do not go together"),),
    )

    def __post_init__(self):
        check_settings(self)


@dataclass(frozen=True, slots=True)
class House:
    """A command's settings, with a record in them."""

    place: Path = declare_setting(MISSING, "", option="PLACE")
    paint: Paint = declare_group(
        Paint(), {"layers": {"option": "--coats"}, "colour": {}, "share": {}}
    )
    doors: bool = declare_setting(True, "No doors.", option="--no-doors", is_off=True)
    lit: bool = declare_setting(True, "Lights.", group=HelpGroup.RUNNING)
    state: str = declare_setting(
        "as it is", "", flags={"new": ("--new", "New."), "old": ("--old", "Old.")}
    )
    lamp: Path | None = declare_setting(None, "Lamp.", unset="none", role="read")
    shade: Path | None = repeat_setting(Paint, "gloss", None, needs="lamp", word=None, name=None)


def build(*words):
    """Return what a command makes of some words: its settings, or the message."""
    made = []

    @click.command(cls=GroupedCommand)
    @OptionGroup("house", House, *list_options(House))
    def command(house):
        made.append(house)

    outcome = CliRunner().invoke(command, [str(word) for word in words])
    return made[0] if made else outcome.output


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"layers": 0}, "`layers=` is 0, expected 1 or more"),
        ({"gloss": 0.0}, "`gloss=` is 0.0, expected a finite number above 0"),
        ({"gloss": float("nan")}, "`gloss=` is nan, expected a finite number above 0"),
        ({"gloss": "dull"}, "`gloss=` is 'dull', expected a finite number above 0"),
        ({"colour": "green"}, "`colour=` is 'green', expected one of red, blue"),
        ({"share": "half"}, "`share=` is 'half', expected 0 to 1"),
        ({"share": 1.5}, "150 % is no share"),
        ({"share": -0.5}, "-50 % is no share"),
        ({"layers": 2.5}, "`layers=` is 2.5, expected 1 or more"),
        ({"layers": True}, "`layers=` is True, expected 1 or more"),
        ({"layers": None}, "`layers=` is None, expected 1 or more"),
        ({"matt": "no"}, "`matt=` is 'no', expected True or False"),
        ({"colour": ["red"]}, "`colour=` is ['red'], expected one of red, blue"),
        ({"gloss": [1.0]}, "`gloss=` is [1.0], expected a finite number above 0"),
        ({"matt": True, "gloss": 3.0}, "`matt=True` and `gloss=3` do not go together"),
    ],
)
def test_values_that_are_not_allowed_are_refused_in_the_words_of_the_declaration(values, says):
    with pytest.raises(SettingError) as caught:
        Paint(**values)
    assert str(caught.value) == says


def test_both_bounds_are_named():
    assert Setting("", minimum=2, maximum=10).describe_allowed(int) == "2 to 10"
    assert Setting("", minimum=2).describe_allowed(int) == "2 or more"


def test_values_at_the_bounds_and_words_are_allowed():
    assert Paint(layers=1, share=1.0, gloss="auto").gloss == "auto"
    assert Paint(matt=True).gloss is None


def test_settings_with_a_name_are_recorded():
    assert describe_settings(Paint()) == {"layers": 2, "paint_gloss": "auto"}
    assert describe_settings(Paint(layers=3, matt=True)) == {
        "layers": 3, "paint_gloss": "auto", "matt": True
    }  # fmt: skip
    assert list_meanings(Paint) == {"layers": "how many", "paint_gloss": "", "matt": ""}


def test_all_settings_are_shown_by_their_fields_with_shares_in_percent():
    shown = {"layers": 2, "gloss": None, "colour": "red", "share_percent": 50.0, "matt": False}
    assert show_settings(Paint()) == shown


def test_options_follow_from_the_declarations():
    house = build(
        "here", "--coats", 3, "--colour", "blue", "--share=25%", "--no-doors", "--no-lit", "--old"
    )
    assert house == House(Path("here"), Paint(3, colour="blue", share=0.25), False, False, "old")
    assert build("here") == House(Path("here"))


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ((), "Missing argument 'PLACE'"),
        (("here", "--coats", 0), "0 is not in the range x>=1"),
        (("here", "--colour", "green"), "'green' is not one of 'red', 'blue'"),
        (("here", "--new", "--old"), "--new and --old exclude each other; leave one out"),
        (("here", "--shade", "1"), "--shade needs --lamp; give both, or neither"),
        (("here", "--share", "x"), "'x' is not a share; expected a finite number"),
        (("here", "--gloss", "1"), "No such option '--gloss'"),
    ],
)
def test_words_that_are_not_allowed_are_wrong_usage(words, says):
    assert says in build(*words)


def test_a_setting_that_is_repeated_has_the_words_of_the_first():
    shade = next(one for one in fields(House) if one.name == "shade").metadata["setting"]
    assert (shade.help, shade.above, shade.needs) == ("Gloss.", 0, "lamp")


def test_values_that_are_no_plain_numbers_are_checked_too():
    setting = Setting("", minimum=2, maximum=10)
    assert setting.is_allowed(np.int64(2))
    assert not setting.is_allowed(np.int64(1))
    assert not setting.is_allowed(10**400)
    assert not Setting("", minimum=0).is_allowed(np.float32("nan"))
    assert not Setting("", choices=("red",)).is_allowed(None)


def test_tuples_are_recorded_as_files_have_them():
    assert describe_settings(ClipSettings(exclude=("teeth",)))["exclude"] == ["teeth"]
