"""Where the weights of a run come from: however that is, they are the same."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cageik_cli.cages.bind import bind
from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.formats.open import load_mesh
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.inputs import weights
from cageik_cli.inputs.settings import WeightSettings
from cageik_cli.inputs.weights import bind_cached, load_matching_binding
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.run.bind import bind_files
from cageik_cli.run.settings import BindRunSettings
from cageik_cli.store.binding_file import read_binding
from cageik_cli.util.errors import InputError, SettingError
from cageik_cli.util.messages import spell
from tests.listeners import Listener
from tests.shapes import ball, box
from tests.texts import texts


@pytest.fixture
def plain(folder):
    """Settings for the first frame of the little animation, without a cache."""
    return BindRunSettings(Path("cage.obj"), Path("frames/frame_1.obj"), Path("binding.h5"))


@pytest.fixture
def made(plain):
    """The binding file, and the meshes that it was made of."""
    bind_files(plain)
    return plain.output, load_mesh(plain.rest), load_mesh(plain.cage)


def test_the_file_holds_what_bind_gives(made):
    path, rest, cage = made
    expected, found = bind(rest.mesh, cage.mesh, jobs=1), read_binding(path)
    np.testing.assert_array_equal(found.binding.weights, expected.weights)
    assert found.binding.settings == BindSettings()
    assert found.sources == {"cage": cage.source, "rest": rest.source}


@pytest.mark.parametrize("kept", [False, True])
def test_a_listener_gets_stages_progress_and_cache_notes(plain, cache, kept):
    how = WeightSettings(cache=cache if kept else None)
    settings = BindRunSettings(plain.cage, plain.rest, plain.output, how, overwrite=True)
    for turn in range(2):
        listener = Listener()
        bind_files(settings, listener)
        assert listener.stages == ["open", "bind", "write"]
        assert listener.counts[-1] == (18, 18)
        assert [topic for topic, _ in listener.notes] == ["cache"] * (kept and turn)
    assert cache.exists() == kept


@pytest.mark.parametrize("coordinates", ["harmonic", "mean-value"])
def test_a_cage_of_many_faces_is_noted_before_it_is_bound(plain, monkeypatch, coordinates):
    monkeypatch.setattr(weights, "MAX_QUICK_FACES", 11)
    listener = Listener()
    settings = WeightSettings(bind=BindSettings(coordinates), cache=None)
    stopped = Listener(stop_at=(18, 18))
    with pytest.raises(KeyboardInterrupt):  # the note is there before the weights are
        bind_files(replace(plain, weights=settings), stopped)
    bind_files(replace(plain, weights=settings, overwrite=True), listener)
    for each in (stopped, listener):
        found = [spell(text) for topic, text in each.notes if topic == "bind"]
        assert len(found) == (coordinates == "harmonic")
        assert all("the cage has 12 faces: their equations take" in text for text in found)


def test_changes_of_a_mesh_are_noted(plain, folder):
    corners = [(x, y, z) for x in (-2, 2) for y in (-2, 2) for z in (-2, 2)]
    sides = ("1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4")
    turned = (" ".join(reversed(side.split())) for side in sides)
    text = "".join("v {} {} {}\n".format(*corner) for corner in corners)
    plain.cage.write_text(text + "".join(f"f {side}\n" for side in turned))
    plain.rest.write_text(text + "".join(f"f {side}\n" for side in sides))
    listener = Listener()
    stored = bind_files(plain, listener)
    assert texts(stored.binding.notes) == (
        "6 polygons cut into triangles to compute with",
        "warning: the cage's faces turn inward; it is used turned outward",
    )
    assert listener.notes == [
        ("note", "frame_1.obj: 6 polygons cut into triangles to compute with")
    ]
    found = load_matching_binding(plain.output, load_mesh(plain.rest), load_mesh(plain.cage))
    assert found.binding.notes == stored.binding.notes


def test_a_binding_matches_its_own_meshes(made):
    path, rest, cage = made
    for given in (cage, None):
        found = load_matching_binding(path, rest, given)
        assert set(found.sources) == {"binding", "cage", "rest"}
        assert found.sources["binding"]["name"] == "binding.h5"
        assert found.sources["cage"] == cage.source
        assert found.sources["rest"] == rest.source


def other(mesh, what):
    vertices, faces = mesh.vertices.copy(), mesh.faces.copy()
    if what == "vertices":
        return TriMesh(np.concatenate([vertices, vertices[:1]]), faces)
    if what == "triangles":
        return TriMesh(vertices, faces[:-1])
    if what == "corners":
        faces[3] = np.roll(faces[3], 1)
        return TriMesh(vertices, faces)
    vertices[[4, 6]] += [[0, 0.003, 0.004], [0, 0, 0.25]]
    return TriMesh(vertices, faces)


@pytest.mark.parametrize(
    ("what", "says"),
    [
        ("vertices", "found 19 vertices, expected 18"),
        ("triangles", "found 31 triangles, expected 32"),
        (
            "positions",
            "vertex 4 is 0.005 away from its place; vertices that differ: 2, by 0.25 at most",
        ),
        ("corners", "triangle 3 has vertices "),
    ],
)
def test_a_binding_of_another_rest_pose_is_refused(made, what, says):
    path, rest, cage = made
    with pytest.raises(SettingError, match=r"^binding\.h5: .*another rest pose") as caught:
        load_matching_binding(path, replace(rest, mesh=other(rest.mesh, what)), cage)
    assert says in str(caught.value)
    assert "`rest=`" in str(caught.value)


@pytest.mark.parametrize(
    ("what", "says"),
    [
        ("positions", "vertex 4 is 0.005 away"),
        ("corners", "triangle 3 has vertices "),
    ],
)
def test_a_binding_of_another_cage_is_refused(made, what, says):
    path, rest, cage = made
    with pytest.raises(SettingError, match=r"^binding\.h5: .*another cage") as caught:
        load_matching_binding(path, rest, replace(cage, mesh=other(cage.mesh, what)))
    assert says in str(caught.value)
    assert "`cage=`" in str(caught.value)


def test_an_open_cage_is_refused_by_its_own_name(made):
    path, rest, cage = made
    with pytest.raises(InputError, match=r"^cage\.obj: .*open"):
        load_matching_binding(path, rest, replace(cage, mesh=other(cage.mesh, "triangles")))


def test_a_missing_binding_is_refused(made):
    _, rest, cage = made
    with pytest.raises(InputError, match=r"^nowhere\.h5: .*no such file"):
        load_matching_binding(Path("nowhere.h5"), rest, cage)


def test_warnings_about_a_cage_are_the_same_from_the_cache(tmp_path):
    rest, cage = ball(4), box(2.0)
    meshes = [LoadedMesh(mesh, {"name": name}) for mesh, name in ((rest, "r"), (cage, "c"))]
    settings = WeightSettings(BindSettings("mean-value"), tmp_path)
    cold, warm = (bind_cached(*meshes, settings, Listener()).binding.notes for _ in range(2))
    assert cold == warm
    assert str(cold[0]).startswith("warning: the cage is loose")
    other = bind_cached(*meshes, settings, Listener(), is_own_cage=False)
    assert texts(other.binding.notes) == ()
