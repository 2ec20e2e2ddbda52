"""Attributes of surfaces in results and bindings: kept whole, and no damage taken for sound."""

import h5py
import numpy as np
import pytest

from cageik_cli.cages.bind import bind
from cageik_cli.formats.open import open_sequence
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.store.binding_file import StoredBinding, read_binding, write_binding
from cageik_cli.util.errors import InputError
from tests.shapes import ball, box, quad_text
from tests.store.damages import assert_refused, attribute, replaced, value, without_attribute
from tests.surfaces import ASSET, CREASES, assert_same, change, read_obj

SOURCES = {"cage": {"name": "c.obj"}, "rest": {"name": "r.obj"}}
GROUP = "attributes/rest"


def make_rest():
    """The asset with creases and colours, too."""
    return change(
        ASSET,
        subdivision=CREASES,
        colours=np.linspace(0, 1, 4 * len(ASSET.vertices)).reshape(-1, 4),
        material_colours=np.linspace(0, 1, 12).reshape(3, 4),
    )


BINDING = bind(make_rest(), read_obj(quad_text(1.0)), BindSettings("mean-value"))


@pytest.fixture
def path(tmp_path):
    write_binding(tmp_path / "b.h5", StoredBinding(BINDING, SOURCES), overwrite=False)
    return tmp_path / "b.h5"


def test_what_is_written_is_read(path):
    read = read_binding(path).binding
    assert_same(read.rest.attributes, BINDING.rest.attributes)
    assert_same(read.cage.attributes, BINDING.cage.attributes)
    assert read.cage.attributes.materials.names == ("red",)


def test_the_same_attributes_give_the_same_bytes(path):
    again = path.with_name("again.h5")
    write_binding(again, read_binding(path), overwrite=False)
    assert again.read_bytes() == path.read_bytes()


def test_triangles_alone_store_nothing(tmp_path):
    bare = bind(ball(1), box(2.0), BindSettings("mean-value"))
    write_binding(tmp_path / "b.h5", StoredBinding(bare, SOURCES), overwrite=False)
    with h5py.File(tmp_path / "b.h5") as file:
        assert "attributes" not in file
    assert read_binding(tmp_path / "b.h5").binding.rest.attributes is None


def test_an_inward_cage_is_turned_with_its_polygons(tmp_path):
    inward = read_obj(quad_text(1.0, inward=True))
    cage = bind(ball(1), inward, BindSettings("mean-value")).cage
    quads = cage.attributes.corners.reshape(-1, 4)
    np.testing.assert_array_equal(quads[:, 0], inward.attributes.corners.reshape(-1, 4)[:, 0])
    np.testing.assert_array_equal(quads[:, 1:], inward.attributes.corners.reshape(-1, 4)[:, :0:-1])
    assert cage.fan_triangulated.volume > 0
    cage.attributes.check_cut(cage.faces)


def swap(group):
    """Put a number in place of the group."""
    file = group.file
    file.move(GROUP, "attributes/old")
    file[GROUP] = 1.0


COUNT = len(BINDING.rest.attributes.corners)
DAMAGES = {
    "no corners": (replaced("corners"), "corners"),
    "floats": (replaced("corners", np.zeros(COUNT)), "corners"),
    "too few corners": (replaced("corners", np.zeros(COUNT - 1, "i4")), "shape"),
    "a vertex that is not there": (value("corners", COUNT - 1, 30), "30"),
    "a negative vertex": (value("corners", 3, -1), "corners are -1"),
    "two corners": (value("corner_counts", 3, 2), "corner_counts are 2"),
    "many corners": (value("corner_counts", 3, 2**31 - 1), "polygons of"),
    "a polygon of others": (value("corners", 3, 29), "normal"),
    "UVs without indices": (replaced("uv_indices"), "whole numbers"),
    "a UV that is not there": (value("uv_indices", 0, 999), "UV indices"),
    "UVs of three numbers": (replaced("uvs", np.zeros((41, 3))), "uvs"),
    "infinite UVs": (value("uvs", 0, np.inf), "UVs are not finite"),
    "colours of five numbers": (replaced("colours", np.zeros((30, 5))), "colours"),
    "colours of materials of three": (
        replaced("material_colours", np.zeros((3, 3))),
        "colours",
    ),
    "colours of other materials": (
        replaced("material_colours", np.zeros((2, 4))),
        "materials",
    ),
    "infinite colours": (value("material_colours", 0, np.inf), "not finite"),
    "colours of others": (replaced("colours", np.zeros((29, 3))), "colours"),
    "a normal of two vertices": (value("normal_fans", 0, 33), "several vertices"),
    "a material that is not there": (value("materials/index", 0, 3), "face names"),
    "names that are numbers": (replaced("materials/name", np.arange(3)), "materials/name"),
    "a name twice": (value("materials/name", 0, "skin"), "twice"),
    "an empty name": (value("materials/name", 0, ""), "0 characters"),
    "a name of two lines": (value("materials/name", 0, "a\nb"), "3 characters"),
    "creases of others": (value("crease_lengths", 0, 4), "creases"),
    "creases of one vertex": (value("crease_lengths", 0, 1), "crease_lengths"),
    "sharpness of others": (replaced("crease_sharpness", np.ones(9)), "sharpness"),
    "a crease elsewhere": (value("crease_vertices", 0, 77), "77"),
    "a scheme that is not known": (attribute("subdivision", "butterfly"), "butterfly"),
    "a library of lines": (attribute("material_library", "a\nb"), "library"),
    "a library of numbers": (attribute("material_library", 3), "material_library"),
    "another UV": (value("uvs", 0, 0.123), "digest"),
    "another name": (value("materials/name", 0, "linen"), "digest"),
    "another library": (attribute("material_library", "x.mtl"), "digest"),
    "no digest": (without_attribute("sha256"), "digest"),
    "no group": (swap, "not a group"),
}


@pytest.mark.parametrize(("damage", "says"), DAMAGES.values(), ids=DAMAGES)
def test_damaged_attributes_are_refused_by_name(path, damage, says):
    assert_refused(path, lambda file: damage(file[GROUP]), says, read_binding)


@pytest.mark.parametrize("name", ["attributes", GROUP])
def test_attributes_of_another_file_are_not_read(path, name):
    path.with_name("other.h5").write_bytes(path.read_bytes())
    with h5py.File(path, "r+") as file:
        del file[name]
        file[name] = h5py.ExternalLink("other.h5", name)
    assert read_binding(path).binding.rest.attributes is None


def test_triangles_that_are_not_cut_from_the_polygons_are_refused(path):
    with h5py.File(path, "r+") as file:
        faces = file["rest/tris"][:]
        file["rest/tris"][:] = np.roll(faces, 1, axis=0)
    with pytest.raises(InputError, match="not of its polygon"):
        read_binding(path)


def test_no_file_without_attributes_is_touched(path):
    """Other programs may have a group of that name beside their clip."""
    with h5py.File(path.with_name("clip.h5"), "w") as file:
        file["verts"], file["tris"] = ball(1).vertices[None], ball(1).faces
        file["attributes/cage/corners"] = "text"
    assert open_sequence([str(path.with_name("clip.h5"))]).first.attributes is None
