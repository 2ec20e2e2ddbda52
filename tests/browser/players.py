"""What the tests of the player share: how they use it, and what it is compared with."""

from pathlib import Path

import numpy as np

from cageik_cli.cli import main

WALKER = Path(__file__).resolve().parent.parent.parent / "data_fixtures" / "walker"

MAX_RMS, MAX_DISTANCE = 1e-5, 1e-4
"""Diagonals: how far drawn positions may be from those of the command line."""


def run_cageik(*arguments) -> None:
    main.main([str(one) for one in arguments], standalone_mode=False)


def settle(page) -> None:
    """Wait until what was asked for is drawn."""
    page.evaluate("() => new Promise((done) => requestAnimationFrame(() => setTimeout(done)))")


def check_positions(page, mesh, diagonal, factor=1) -> None:
    """Compare the drawn positions with a mesh, (m, 3); the factor is of what is allowed."""
    settle(page)
    found = np.array(page.evaluate("P.positions()"))
    distances = np.linalg.norm(found - mesh, axis=1) / diagonal
    assert np.sqrt((distances**2).mean()) <= factor * MAX_RMS
    assert distances.max() <= factor * MAX_DISTANCE


def drag(page, start, stop, steps=8) -> None:
    page.mouse.move(*start)
    page.mouse.down()
    page.mouse.move(*stop, steps=steps)
    page.mouse.up()


def middle_of(page, selector="#player canvas"):
    box = page.locator(selector).bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def camera_of(page):
    return page.evaluate("(({turn, tilt, distance, target}) => ({turn, tilt, distance, target}))"
                         "(P.stage.camera)")  # fmt: skip
