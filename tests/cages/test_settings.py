"""What may be asked of a cage that is built."""

import re

import pytest

from cageik_cli.cages.settings import BuildSettings
from cageik_cli.util.errors import SettingError


@pytest.mark.parametrize("vertices", [7, 2001, -1])
def test_too_few_and_too_many_vertices_are_refused(vertices):
    with pytest.raises(SettingError, match=f"{vertices} vertices.*8 to 2000"):
        BuildSettings(vertices)


@pytest.mark.parametrize(
    ("clearance", "percent"), [(0.0, "0"), (0.3, "30"), (float("nan"), "nan"), (-0.1, "-10")]
)
def test_a_clearance_out_of_range_is_refused(clearance, percent):
    with pytest.raises(SettingError, match=re.escape(f"{percent} % of the diagonal")):
        BuildSettings(100, clearance)


def test_a_plane_that_is_none_is_refused():
    with pytest.raises(SettingError, match="'w', expected one of auto, x, y, z, off"):
        BuildSettings(symmetric="w")


@pytest.mark.parametrize("values", [(8, 1e-6), (2000, 0.2)])
def test_the_limits_themselves_are_taken(values):
    assert (BuildSettings(*values).vertices, BuildSettings(*values).clearance) == values
