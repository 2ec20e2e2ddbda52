"""Which axis is which: told by lengths and by how many vertices there are, else asked for."""

import pytest

from cageik_cli.formats.npz import choose_layout, list_layouts
from cageik_cli.util.errors import FormatError, SettingError
from tests.refusals import refused


@pytest.mark.parametrize(
    ("shape", "layout", "found"),
    [
        ((7, 5, 3), None, ["fvx"]),
        ((5, 3, 7), None, ["vxf", "fxv"]),
        ((5, 3, 7), "vxf", ["vxf"]),
        ((5, 3, 7), "fxv", ["fxv"]),
        ((3, 5, 3), None, ["fvx"]),
        ((5, 3, 3), None, ["fvx", "vxf", "fxv"]),
    ],
)
def test_an_axis_of_three_is_the_coordinates(shape, layout, found):
    assert list_layouts(shape, layout) == found


@pytest.mark.parametrize(
    ("shape", "layout", "says"),
    [
        ((3, 5, 7), None, "expected (frames, vertices, 3) or (vertices, 3, frames) or (frames, 3"),
        ((5, 3), None, "positions have shape (5, 3)"),
        ((2, 5, 3, 3), None, "positions have shape (2, 5, 3, 3)"),
        ((), None, "positions have shape ()"),
        ((0, 5, 3), None, "positions have shape (0, 5, 3)"),
        ((5, 0, 3), None, "positions have shape (5, 0, 3)"),
        ((7, 5, 3), "fxv", "expected (frames, 3, vertices)"),
    ],
)
def test_other_shapes_are_refused(shape, layout, says):
    with refused(FormatError, says):
        list_layouts(shape, layout)


@pytest.mark.parametrize(
    ("shape", "named", "layout"),
    [
        ((7, 5, 3), None, "fvx"),
        ((7, 5, 3), 99, "fvx"),
        ((5, 3, 7), 5, "vxf"),
        ((5, 3, 7), 7, "fxv"),
        ((5, 3, 7), 6, "fxv"),
        ((5, 3, 3), 5, "vxf"),
        ((5, 3, 3), 4, "vxf"),
    ],
)
def test_the_vertices_that_are_named_decide(shape, named, layout):
    assert choose_layout(list_layouts(shape, None), shape, named) == layout


@pytest.mark.parametrize(
    ("shape", "named", "says"),
    [
        ((5, 3, 7), None, "vxf (7 frames of 5 vertices) or fxv (5 frames of 7 vertices)"),
        ((5, 3, 7), 4, "vxf (7 frames of 5 vertices) or fxv (5 frames of 7 vertices)"),
        ((5, 3, 7), 8, "vxf (7 frames of 5 vertices) or fxv (5 frames of 7 vertices)"),
        ((5, 3, 5), 5, "vxf (5 frames of 5 vertices) or fxv (5 frames of 5 vertices)"),
        ((5, 3, 3), 3, "fvx (5 frames of 3 vertices) or fxv (5 frames of 3 vertices)"),
        ((3, 3, 3), 3, "fvx (3 frames of 3 vertices) or vxf (3 frames of 3 vertices) or fxv"),
    ],
)
def test_several_readings_are_asked_about(shape, named, says):
    with pytest.raises(SettingError) as caught:
        choose_layout(list_layouts(shape, None), shape, named)
    assert says in str(caught.value)
    assert str(caught.value).endswith("`layout=`")
