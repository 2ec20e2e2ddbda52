"""Attributes of surfaces in results and bindings: kept whole, and no damage taken for sound."""

import h5py
import numpy as np
import pytest

from cageik_cli.cages.bind import bind
from cageik_cli.coordinates.settings import BindSettings
from cageik_cli.formats.open import open_sequence
from cageik_cli.store.binding_file import StoredBinding, read_binding, write_binding
from cageik_cli.util.errors import InputError
from tests.shapes import ball, box, quad_text
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


def damage(name, value):
    """A dataset with another value."""

    def apply(file):
        del file[f"{GROUP}/{name}"]
        if value is not None:
            file[f"{GROUP}/{name}"] = value

    return apply


def set_number(name, index, value):
    """A dataset with another number."""

    def apply(file):
        file[f"{GROUP}/{name}"][index] = value

    return apply


def swap(file):
    file.move(GROUP, "attributes/old")
    file[GROUP] = 1.0


def attribute(name, value):
    return lambda file: file[GROUP].attrs.__setitem__(name, value)


COUNT = len(BINDING.rest.attributes.corners)
DAMAGES = {
    "no corners": (damage("corners", None), "corners"),
    "floats": (damage("corners", np.zeros(COUNT)), "corners"),
    "too few corners": (damage("corners", np.zeros(COUNT - 1, "i4")), "shape"),
    "a vertex that is not there": (set_number("corners", COUNT - 1, 30), "30"),
    "a negative vertex": (set_number("corners", 3, -1), "corners are -1"),
    "two corners": (set_number("corner_counts", 3, 2), "corner_counts are 2"),
    "many corners": (set_number("corner_counts", 3, 2**31 - 1), "polygons of"),
    "a polygon of others": (set_number("corners", 3, 29), "normal"),
    "UVs without indices": (damage("uv_indices", None), "whole numbers"),
    "a UV that is not there": (set_number("uv_indices", 0, 999), "UV indices"),
    "UVs of three numbers": (damage("uvs", np.zeros((41, 3))), "uvs"),
    "infinite UVs": (set_number("uvs", 0, np.inf), "UVs are not finite"),
    "colours of five numbers": (damage("colours", np.zeros((30, 5))), "colours"),
    "colours of materials of three": (damage("material_colours", np.zeros((3, 3))), "colours"),
    "colours of other materials": (damage("material_colours", np.zeros((2, 4))), "materials"),
    "infinite colours": (set_number("material_colours", 0, np.inf), "not finite"),
    "colours of others": (damage("colours", np.zeros((29, 3))), "colours"),
    "a normal of two vertices": (set_number("normal_fans", 0, 33), "several vertices"),
    "a material that is not there": (set_number("materials/index", 0, 3), "face names"),
    "names that are numbers": (damage("materials/name", np.arange(3)), "materials/name"),
    "a name twice": (set_number("materials/name", 0, "skin"), "twice"),
    "an empty name": (set_number("materials/name", 0, ""), "0 characters"),
    "a name of two lines": (set_number("materials/name", 0, "a\nb"), "3 characters"),
    "creases of others": (set_number("crease_lengths", 0, 4), "creases"),
    "creases of one vertex": (set_number("crease_lengths", 0, 1), "crease_lengths"),
    "sharpness of others": (damage("crease_sharpness", np.ones(9)), "sharpness"),
    "a crease elsewhere": (set_number("crease_vertices", 0, 77), "77"),
    "a scheme that is not known": (attribute("subdivision", "butterfly"), "butterfly"),
    "a library of lines": (attribute("material_library", "a\nb"), "library"),
    "a library of numbers": (attribute("material_library", 3), "material_library"),
    "another UV": (set_number("uvs", 0, 0.123), "digest"),
    "another name": (set_number("materials/name", 0, "linen"), "digest"),
    "another library": (attribute("material_library", "x.mtl"), "digest"),
    "no digest": (lambda file: file[GROUP].attrs.__delitem__("sha256"), "digest"),
    "no group": (swap, "not a group"),
}


@pytest.mark.parametrize(("apply", "says"), DAMAGES.values(), ids=DAMAGES)
def test_damaged_attributes_are_refused_by_name(path, apply, says):
    with h5py.File(path, "r+") as file:
        apply(file)
    with pytest.raises(InputError, match=rf"^[^\n]*b\.h5: [^\n]*{says}"):
        read_binding(path)


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
