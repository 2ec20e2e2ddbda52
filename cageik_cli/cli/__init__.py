"""The `cageik` command: parse, call one workflow, show what it did.

Only this folder uses click and tqdm. It depends on `workflows` and, for what it shows, on
`report`; both are imported when a command runs, so that `--help` is quick. Start with `extract.py`.
Options that commands share are in `options/`; `errors.py` decides the exit code of an error.
"""

import click

from cageik_cli import __version__
from cageik_cli.cli.batch import batch_command
from cageik_cli.cli.bind import bind_command
from cageik_cli.cli.check import check_command
from cageik_cli.cli.deform import deform_command
from cageik_cli.cli.errors import CageikGroup
from cageik_cli.cli.export import export_command
from cageik_cli.cli.extract import extract_command
from cageik_cli.cli.info import info_command
from cageik_cli.cli.pose import pose_command
from cageik_cli.cli.report import report_command


@click.group(
    cls=CageikGroup,
    commands=[
        extract_command,
        batch_command,
        report_command,
        export_command,
        deform_command,
        pose_command,
        bind_command,
        check_command,
        info_command,
    ],
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.version_option(__version__, prog_name="cageik")
def main() -> None:
    """Turn a mesh animation into a cage animation.

    \b
    cageik extract frames/*.obj --cage cage.obj
    cageik report
    """  # noqa: D301
