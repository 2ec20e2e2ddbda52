"""A small clip to be played."""

import pytest

from cageik_cli.report.player.clip import load_player_clip


@pytest.fixture(scope="session")
def clip(closed):
    return load_player_clip(closed.result)
