"""The settings of a report: the results, and the files of its views. It imports no numerics."""

from dataclasses import dataclass, fields
from pathlib import Path

from cageik_cli.inputs.settings import CommandSettings, declare_overwrite
from cageik_cli.report.film.settings import FILM_SUFFIXES, FilmSettings
from cageik_cli.util.errors import SettingError
from cageik_cli.util.messages import Hint, say
from cageik_cli.util.settings import check_settings, declare_group, declare_setting


@dataclass(frozen=True, slots=True)
class ReportTargets:
    """The file that each view of a report is written to; `-` is stdout on the command line."""

    html: Path | None = declare_setting(
        None, "Write the page of one result, complete in one file.", role="written"
    )
    plot: Path | None = declare_setting(
        None,
        "Draw RMS error and volume over the frames (.png, .svg).",
        suffixes=(".png", ".svg"),
        role="written",
    )
    json: Path | None = declare_setting(
        None, "Write the record as JSON; - is stdout.", role="written"
    )
    csv: Path | None = declare_setting(
        None, "Write CSV with one line per frame; - is stdout.", role="written"
    )
    junit: Path | None = declare_setting(
        None, "Write JUnit XML with one test case per limit; - is stdout.", role="written"
    )
    markdown: Path | None = declare_setting(
        None, "Write a Markdown table of the results; - is stdout.", role="written"
    )
    player: Path | None = declare_setting(
        None,
        "Write a small page of one result that plays and poses it (.html).",
        suffixes=(".html",),
        role="written",
    )
    film: Path | None = declare_setting(
        None,
        "Draw a film of one result (.webp, .gif, .mp4, .webm; DIR/NAME_####.png).",
        suffixes=FILM_SUFFIXES,
        role="written",
    )
    no_player: bool = declare_setting(False, "Leave the player out of the page of --html.")

    def __post_init__(self) -> None:
        check_settings(self)
        on_stdout = [Hint(name) for name, path in self.named.items() if str(path) == "-"]
        if len(on_stdout) > 1:
            raise SettingError(
                on_stdout[0] + " and " + on_stdout[1] + " both go to stdout; write one to a file"
            )

    @property
    def named(self) -> dict[str, Path]:
        """The targets that are given, by the names of the views."""
        values = {one.name: getattr(self, one.name) for one in fields(self)}
        return {name: path for name, path in values.items() if isinstance(path, Path)}


@dataclass(frozen=True, slots=True)
class ReportSettings(CommandSettings):
    """Which results to report on, and the views of the report.

    Attributes
    ----------
    results : tuple of Path
        One at least; several have no views of one.
    """

    results: tuple[Path, ...] = declare_setting((), "", option="RESULTS", role="read")
    targets: ReportTargets = declare_group(ReportTargets())
    film_settings: FilmSettings = declare_group(FilmSettings())
    overwrite: bool = declare_overwrite()

    def __post_init__(self) -> None:
        CommandSettings.__post_init__(self)
        for name in ("html", "plot", "player", "film"):
            if name in self.targets.named and len(self.results) > 1:
                raise SettingError(
                    Hint(name) + f" shows one result, {len(self.results)} were named; name one, "
                    "or use cageik batch"
                )
        film, usual = self.film_settings, FilmSettings()
        for one in fields(film):
            if self.targets.film is None and getattr(film, one.name) != getattr(usual, one.name):
                message = ": no film is written; name one with `film=FILE.webp`"
                raise SettingError(Hint(one.name) + say(message))
