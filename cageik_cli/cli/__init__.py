"""The `cageik` command: parse, call one run, show what it did.

Only this folder uses click and tqdm. It depends on `run` and, for what it shows, on
`report`; both are imported when a command runs, so that `--help` is quick. Start with `extract.py`.
Options that commands share are in `options/`; `group.py` decides the exit code of an error.
"""

import click

from cageik_cli.cli.group import CageikGroup, LazyCommands
from cageik_cli.util.compiled import describe_core
from cageik_cli.util.version import __version__


@click.group(
    cls=CageikGroup,
    commands=LazyCommands(
        {
            "batch": "Extract every clip under some folders.",
            "bind": "Compute and save the weights of a model.",
            "cage": "Build a cage around a model, or repair one.",
            "check": "Diagnose a cage.",
            "deform": "Move a mesh, points or splats by cages.",
            "export": "Convert a cage animation to other formats.",
            "extract": "Extract the cage of every frame.",
            "info": "Describe files.",
            "pose": "Move a model or clip by points or its cage.",
            "report": "Show how well results fit; check limits.",
            "view": "Play a clip or pose a model in the browser.",
        }
    ),
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(
    __version__,
    prog_name="cageik",
    message=f"%(prog)s, version %(version)s\ncore: {describe_core()}",
)
def main() -> None:
    """Turn a mesh animation into a cage animation.

    \b
    cageik extract frames/*.obj --cage cage.obj
    cageik report
    """  # noqa: D301
