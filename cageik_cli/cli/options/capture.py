"""Options for clips from scanners and trackers."""

import click

from cageik_cli.cli.options.group import OptionGroup
from cageik_cli.solver.settings import CaptureSettings

CAPTURE_OPTIONS = OptionGroup(
    "capture",
    CaptureSettings,
    click.option(
        "--robust", is_flag=True, help="Reject vertices that are thrown away in some frames."
    ),
)
