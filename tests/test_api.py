"""The Python API: what `from cageik_cli import ...` gives, and the examples of its docstrings."""

import doctest
from pathlib import Path

import numpy as np
import pytest

import cageik_cli
from cageik_cli.formats.base.sequence import as_sequence
from cageik_cli.method.weights import harmonic
from cageik_cli.util.errors import ConnectivityError, SettingError
from tests.texts import texts


@pytest.fixture(autouse=True)
def workspace(tmp_path, monkeypatch, fixtures_folder) -> Path:
    """A current folder with the fixtures in it, as in a clone."""
    (tmp_path / "data_fixtures").symlink_to(fixtures_folder, target_is_directory=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def known_weights() -> dict:
    """The weights that examples have computed, by points, cage and accuracy."""
    return {}


@pytest.fixture
def weights_once(monkeypatch, known_weights) -> None:
    """The examples bind the walking figure again and again: its weights are computed once."""
    compute = harmonic.harmonic_weights

    def compute_once(cage, points, accuracy="standard", *others, **named):
        key = (points.tobytes(), cage.vertices.tobytes(), accuracy)
        if key not in known_weights:
            known_weights[key] = compute(cage, points, accuracy, *others, **named)
        return known_weights[key]

    monkeypatch.setattr(harmonic, "harmonic_weights", compute_once)


def find_examples(thing, name):
    """Return the examples of a public name; a name without any is a failure."""
    assert "Examples\n" in (thing.__doc__ or ""), f"{name} has no example"
    (test,) = doctest.DocTestFinder(recurse=False).find(thing, name, globs={})
    assert test.examples, f"{name} has no example"
    return test


BUILDING = ("BuiltCage", "build_cage")
"""Names whose examples build a cage, which takes seconds."""


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.slow] if name in BUILDING else [])
        for name in cageik_cli.__all__
    ],
)
@pytest.mark.usefixtures("weights_once")
def test_every_public_name_has_an_example_that_runs(name):
    test = find_examples(getattr(cageik_cli, name), name)
    output = []
    results = doctest.DocTestRunner().run(test, out=output.append)
    assert results.failed == 0, "".join(output)


@pytest.mark.parametrize("text", ["", "Do it.", "Examples\n--------\nNone yet.\n"])
def test_a_public_name_without_an_example_is_found(text):
    def function():
        pass

    function.__doc__ = text
    with pytest.raises(AssertionError, match="extrude has no example"):
        find_examples(function, "extrude")


def test_an_example_that_is_wrong_is_found():
    test = doctest.DocTestParser().get_doctest(">>> 1 + 1\n3\n", {}, "wrong", None, 0)
    assert doctest.DocTestRunner().run(test, out=lambda text: None).failed == 1


def test_the_package_imports_no_numerics_until_a_name_is_used(run_process):
    program = """
import sys, cageik_cli
assert not {"numpy", "scipy", "h5py", "click"} & set(sys.modules), "numerics are imported"
assert set(cageik_cli.__all__) <= set(dir(cageik_cli))
cageik_cli.TriMesh
assert "numpy" in sys.modules and "h5py" not in sys.modules
"""
    outcome = run_process("-c", program)
    assert (outcome.code, outcome.err) == (0, "")


def test_a_name_that_is_not_public_is_an_attribute_error():
    with pytest.raises(AttributeError, match="'extrude'"):
        cageik_cli.extrude  # noqa: B018


def test_star_import_gives_the_public_names():
    names: dict[str, object] = {}
    exec("from cageik_cli import *", names)
    assert set(cageik_cli.__all__) <= set(names)


@pytest.fixture
def binding(animation, coarse_panels):
    return cageik_cli.bind(animation.rest, animation.cage)


def test_arrays_and_clips_give_the_cages_of_the_command(folder, run, binding, animation):
    clip = cageik_cli.load_clip("frames")
    of_clip = cageik_cli.extract(clip, binding)
    of_array = cageik_cli.extract(animation.frames, binding)
    np.testing.assert_array_equal(of_clip.cages, of_array.cages)
    assert run("extract", "frames", "--cage", "cage.obj", "-q").code == 0
    result = cageik_cli.read_result("cages.h5")
    np.testing.assert_array_equal(cageik_cli.read_cages(result), of_clip.cages)
    np.testing.assert_array_equal(result.metrics.rms, of_clip.rms)
    np.testing.assert_array_equal(result.metrics.max_deviation, of_clip.max_deviation)


def test_a_file_has_the_bytes_of_the_command(folder, run):
    cageik_cli.extract_to_file(["frames/frame_1.obj", "frames/frame_2.obj"], "cage.obj", "api.h5")
    assert run("extract", "frames", "--frames", ":2", "--cage", "cage.obj", "-q").code == 0
    assert Path("api.h5").read_bytes() == Path("cages.h5").read_bytes()


def test_the_error_is_that_of_the_reconstruction(binding, animation):
    found = cageik_cli.extract(animation.frames, binding)
    rebuilt = np.stack([found.reconstruct(k) for k in range(len(found))])
    distances = np.linalg.norm(rebuilt - animation.frames, axis=2)
    np.testing.assert_allclose(found.max_deviation, distances.max(axis=1), rtol=1e-12, atol=0)
    rms = np.sqrt((distances**2).mean())
    assert found.rms_percent == pytest.approx(100 * rms / animation.rest.diagonal, rel=1e-12)


def test_the_memory_limit_changes_no_cage(binding, animation):
    whole = cageik_cli.extract(animation.frames, binding)
    little = cageik_cli.extract(animation.frames, binding, memory=1)
    np.testing.assert_array_equal(little.cages, whole.cages)


def test_missing_data_is_not_fitted(binding, animation):
    weights = np.ones(len(animation.rest.vertices))
    weights[3] = 0
    frames = animation.frames.copy()
    frames[:, 3] += 1000
    found = cageik_cli.extract(frames, binding, vertex_weights=weights)
    assert found.rms.max() < 1


def test_progress_is_called_until_all_frames_are_done(binding, animation, single_frame_blocks):
    calls = []
    cageik_cli.extract(animation.frames, binding, progress=lambda *done: calls.append(done))
    assert calls[-1] == (5, 5)
    assert len(calls) == 5


@pytest.mark.parametrize("shape", [(2, 17, 3), (0, 18, 3), (18, 3), (2, 18, 2)])
def test_frames_of_another_shape_are_refused(binding, shape):
    with pytest.raises(ConnectivityError, match="18"):
        cageik_cli.extract(np.zeros(shape), binding)


def test_settings_that_cannot_be_are_refused(binding, animation):
    with pytest.raises(SettingError, match=r"`alpha=` is -1\.0"):
        cageik_cli.extract(animation.frames, binding, alpha=-1.0)
    with pytest.raises(SettingError, match="best"):
        cageik_cli.bind(animation.rest, animation.cage, accuracy="best")


def test_a_frame_that_is_not_finite_is_refused(binding, animation):
    frames = animation.frames.copy()
    frames[1, 4, 2] = np.nan
    with pytest.raises(cageik_cli.CageikError, match="vertex 4"):
        cageik_cli.extract(frames, binding)


def test_a_cage_that_is_open_is_not_fit(animation):
    opened = cageik_cli.TriMesh(animation.cage.vertices, animation.cage.faces[1:])
    diagnosis = cageik_cli.check_cage(opened)
    assert not diagnosis.is_fit
    assert repr(diagnosis).startswith("<Diagnosis: unfit, ")


@pytest.mark.slow
@pytest.mark.usefixtures("folder", "coarse_grids")
def test_a_cage_is_built_where_none_is_given(run, animation):
    clip = cageik_cli.load_clip("frames")
    built = cageik_cli.build_cage(clip.first, vertices=20)
    assert repr(built) == ("<BuiltCage: 20 vertices, 36 triangles, best of 1 candidate, 0 notes>")
    found = cageik_cli.extract(clip, cage_vertices=20)
    np.testing.assert_array_equal(found.binding.cage.vertices, built.cage.vertices)
    cageik_cli.extract_to_file("frames", None, "api.h5", cage_vertices=20, rest_frame="auto")
    words = ("--cage-vertices", "20", "--rest-frame", "auto", "-q")
    assert run("extract", "frames", *words).code == 0
    assert Path("api.h5").read_bytes() == Path("cages.h5").read_bytes()


@pytest.mark.slow
@pytest.mark.usefixtures("folder", "coarse_grids")
def test_a_cage_for_frames_has_their_least_error(animation):
    clip = cageik_cli.load_clip("frames")
    built = cageik_cli.build_cage(clip.first, vertices=20, frames=clip)
    errors = [known.error for known in built.candidates if known.error is not None]
    assert built.chosen.error == min(errors)


@pytest.mark.usefixtures("folder")
def test_frames_for_a_cage_may_be_an_array(animation):
    clip = cageik_cli.load_clip("frames")
    found = [np.stack([*as_sequence(one, clip.first)]) for one in (clip, animation.frames)]
    np.testing.assert_array_equal(*found)


@pytest.mark.slow
def test_a_loose_cage_has_a_note(animation, monkeypatch, coarse_grids):
    monkeypatch.setattr("cageik_cli.cages.builder.build.make_shell", lambda *_: None)
    (note,) = texts(cageik_cli.build_cage(animation.rest, vertices=20).notes)
    assert "ellipsoid" in note


def test_frames_of_another_mesh_are_refused(animation):
    for frames in (animation.frames[:, :-1], animation.frames[:0], animation.frames[0]):
        with pytest.raises(ConnectivityError, match="18 vertices"):
            cageik_cli.build_cage(animation.rest, frames=frames)


def test_a_cage_is_given_or_built(folder, binding, animation):
    with pytest.raises(SettingError, match="cage_vertices is 20"):
        cageik_cli.extract(animation.frames, binding, cage_vertices=20)
    with pytest.raises(SettingError, match=r"cage_vertices is 20.*cage\.obj"):
        cageik_cli.extract_to_file("frames", "cage.obj", "x.h5", cage_vertices=20)
    with pytest.raises(SettingError, match="no faces"):
        cageik_cli.extract(animation.frames)
    with pytest.raises(SettingError, match="a cage of 7 vertices"):
        cageik_cli.build_cage(animation.rest, vertices=7)


def test_every_repr_is_one_line(binding, animation):
    point = cageik_cli.point_at_vertex(animation.rest, 3)
    anchor = cageik_cli.Anchor("tip", point)
    things = [
        animation.rest,
        binding,
        cageik_cli.extract(animation.frames, binding),
        anchor,
        cageik_cli.Poser(binding, [anchor]),
        cageik_cli.check_cage(animation.cage, animation.rest),
    ]
    for thing in things:
        text = repr(thing)
        assert text.startswith(f"<{type(thing).__name__}: ")
        assert text.endswith(">")
        assert len(text) < 100
        assert "\n" not in text


def test_the_readme_walk(folder):
    """Load a clip, bind, extract, measure."""
    clip = cageik_cli.load_clip(Path("frames"), selection=slice(1, None, 2))
    assert repr(clip) == "<MeshSequence: 2 frames of 18 vertices, frame_2.obj to frame_4.obj>"
    cage = cageik_cli.load_mesh("cage.obj")
    animation = cageik_cli.extract(clip, cageik_cli.bind(clip.first, cage))
    assert animation.cages.shape == (2, 8, 3)


@pytest.mark.parametrize("selection", [5, 0, (1, 2), "", slice(0, 9, 0), slice("a", None)])
def test_a_clip_has_frames_of_a_slice_or_of_numbers_only(selection):
    with pytest.raises(SettingError, match=r"is not a choice of frames|`selection=` is "):
        cageik_cli.load_clip("data_fixtures/walker/frames", selection=selection)


def test_extraction_to_arrays_and_to_a_file_fit_the_same_weights():
    clip = cageik_cli.load_clip("data_fixtures/walker/frames", selection=slice(0, 4))
    cage = cageik_cli.load_mesh("data_fixtures/walker/cage.obj")
    binding = cageik_cli.bind(clip.first, cage, accuracy="preview")
    settings = cageik_cli.FitSettings(0.3)
    animation = cageik_cli.extract(clip, binding, fit=settings)
    frames = np.stack(list(clip))
    fitted = cageik_cli.fit_weights(binding, [frames], settings)
    np.testing.assert_array_equal(animation.binding.weights, fitted.binding.weights)
    names = [f"data_fixtures/walker/frames/walker_{k}.obj" for k in range(1, 5)]
    result = cageik_cli.extract_to_file(
        names, "data_fixtures/walker/cage.obj", "a.h5", accuracy="preview", fit=settings
    )
    np.testing.assert_allclose(result.metrics.rms, animation.rms, rtol=1e-9, atol=1e-12)
    assert repr(fitted) == "<FittedWeights: 1570 vertices in a cage of 80, fitted to 4 of 4 frames>"


def test_frames_of_another_model_cannot_be_fitted(binding):
    with pytest.raises(ConnectivityError, match="17"):
        cageik_cli.fit_weights(binding, [np.zeros((2, 17, 3))])
