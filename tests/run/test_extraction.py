"""The run, end to end: known cages come back, and what must not matter does not."""

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from cageik_cli.formats.settings import SceneHints
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.method.weights.binding import Binding
from cageik_cli.report.record import build_report
from cageik_cli.report.views.text import format_text
from cageik_cli.run.executor import ARRAYS_PER_FRAME, MemoryPlan, choose_block_size
from cageik_cli.run.extraction import extract
from cageik_cli.run.settings import ExtractSettings
from cageik_cli.util.errors import InputError, NumericalError
from tests.listeners import Listener
from tests.shapes import ball, box, rotation
from tests.texts import texts

TRUTH = SolveSettings(alpha=0.0)


def cages_of(settings):
    result = extract(settings)
    with h5py.File(result.path) as file:
        return file["verts"][:]


@pytest.fixture
def posed(fixtures_folder, tmp_path):
    """Settings for frames that are exactly weights times known cages."""

    def settings(case, **options):
        folder = fixtures_folder / "posed" / case
        options = {"frames": (str(folder / "frames"),), "solve": TRUTH} | options
        return ExtractSettings(
            cage=folder / "cage.obj", output=tmp_path / "cages.h5", overwrite=True, **options
        )

    return settings


@pytest.fixture
def plain(folder):
    """Settings for the little animation."""
    return ExtractSettings(
        frames=("frames",), cage=Path("cage.obj"), output=Path("cages.h5"), overwrite=True
    )


@pytest.fixture(scope="session")
def walker(fixtures_folder, tmp_path_factory, weights_cache):
    """Settings for every eighth frame of the walking figure, and their result."""
    frames = fixtures_folder / "walker" / "frames"
    settings = ExtractSettings(
        frames=tuple(str(frames / f"walker_{k}.obj") for k in range(1, 49, 8)),
        cage=fixtures_folder / "walker" / "cage.obj",
        output=tmp_path_factory.mktemp("walker") / "cages.h5",
        cache=weights_cache,
    )
    return settings, extract(settings)


def positions_of(folder, names):
    return np.array(
        [
            [
                line.split()[1:]
                for line in (folder / name).read_text().splitlines()
                if line[0] == "v"
            ]
            for name in names
        ],
        float,
    )


@pytest.mark.parametrize(("case", "atol"), [("surface", 1e-10), ("tetrahedron", 1e-9)])
@pytest.mark.parametrize("align", [True, False])
def test_known_cages_come_back(posed, case, atol, align):
    settings = posed(case, solve=SolveSettings(alpha=0.0, align=align))
    known = np.load(settings.cage.parent / "cages.npz")["verts"]
    misses = np.linalg.norm(cages_of(settings) - known, axis=2)
    diagonal = np.linalg.norm(np.ptp(positions_of(settings.cage.parent, ["frames/frame_1.obj"]), 1))
    assert misses.max() <= atol * diagonal


def test_the_metrics_of_the_walker_match_weights_times_cages(walker, fixtures_folder):
    settings, result = walker
    frames = positions_of(fixtures_folder / "walker" / "frames", result.frames)
    with h5py.File(settings.output) as file:
        rebuilt = file["weights"][:] @ file["verts"][:]
    misses = np.linalg.norm(rebuilt - frames, axis=2)
    rms = np.sqrt((misses**2).mean(axis=1))
    np.testing.assert_allclose(result.metrics.rms, rms, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(
        result.metrics.max_deviation, misses.max(axis=1), rtol=1e-9, atol=1e-12
    )
    # The first frame is the rest pose, whose misses are rounding.
    np.testing.assert_array_equal(result.metrics.worst_vertex[1:], misses.argmax(axis=1)[1:])
    assert 0 < rms.max() < 0.005 * result.rest.diagonal
    assert result.frames == tuple(f"walker_{k}.obj" for k in (1, 9, 17, 25, 33, 41))


@pytest.mark.parametrize("memory", [1, 3 << 20])
def test_memory_and_threads_do_not_change_the_bytes(walker, tmp_path, memory):
    """That is room for the weights alone, and for three frames; there are six."""
    settings, result = walker
    other = extract(replace(settings, output=tmp_path / "other.h5", memory=memory, jobs=3))
    assert other.path.read_bytes() == result.path.read_bytes()


@pytest.mark.parametrize(
    ("frames", "jobs", "expected"),
    [(-1, 4, (16, 1)), (10, 4, (16, 1)), (31.9, 4, (16, 1)), (40, 4, (16, 2)), (1000, 4, (16, 4))],
)
def test_weights_and_blocks_fit_the_memory(frames, jobs, expected):
    """Memory for the weights and so many frames; arrays of a frame are `ARRAYS_PER_FRAME`.

    One block is always held.
    """
    model = ball(2)
    binding = Binding(model, box(2.0), np.zeros((len(model.vertices), 8)))
    frame = ARRAYS_PER_FRAME * model.vertices.nbytes
    memory = binding.weights.nbytes + int(frames * frame)
    found = MemoryPlan.make(memory, binding, jobs)
    assert (found.block_size, found.max_parallel_blocks) == expected


@pytest.mark.parametrize(
    ("vertices", "frames"), [(1, 16), (50_000, 16), (100_000, 9), (900_000, 1), (10**8, 1)]
)
def test_blocks_of_large_models_have_fewer_frames(vertices, frames):
    assert choose_block_size(vertices) == frames
    assert frames * vertices * 24 * ARRAYS_PER_FRAME <= 1 << 28 or frames == 1


@pytest.mark.parametrize(("memory", "frames"), [(1, 1), (8 * 10, 10), (1 << 60, 1 << 24)])
def test_the_queue_is_a_part_of_the_memory(memory, frames):
    """For a model of which a frame takes 24 bytes times its vertices."""
    model = ball(2)
    size = model.vertices.nbytes
    binding = Binding(model, box(2.0), np.zeros((len(model.vertices), 8)))
    expected = frames if frames < 1 << 24 else frames // size
    assert (
        MemoryPlan.make(memory * (size if memory < 1 << 50 else 1), binding, 1).max_queued_frames
        == expected
    )


def test_the_rest_pose_is_the_first_frame_another_or_a_mesh(plain, folder, animation, write_obj):
    first = cages_of(plain)
    mesh = write_obj(folder / "rest.obj", animation.frames[0], animation.rest.faces)
    np.testing.assert_array_equal(cages_of(replace(plain, rest=mesh)), first)
    # Frame 3 in a cage moved along with it is another rest pose.
    moved = replace(plain, rest_frame=3, cage=folder / "moved.obj")
    write_obj(moved.cage, animation.cage.vertices + np.array([0, 1.5, 0.75]), animation.cage.faces)
    result = extract(moved)
    np.testing.assert_array_equal(result.rest.vertices, animation.frames[3])
    assert result.metrics.rms.argmin() == 3
    assert result.metrics.rms[3] <= 1e-14 * result.rest.diagonal
    assert result.settings["rest_frame"] == 3


@pytest.mark.parametrize("index", [-1, 5])
def test_a_missing_rest_frame_is_refused(plain, index):
    with pytest.raises(InputError, match=f"`rest_frame={index}`: .*5 frames"):
        extract(replace(plain, rest_frame=index))


def test_a_rest_pose_of_another_connectivity_is_refused(plain, folder, animation, write_obj):
    rest = animation.rest
    path = write_obj(folder / "rest.obj", rest.vertices[:-1], rest.faces[(rest.faces < 17).all(1)])
    with pytest.raises(InputError, match=r"rest\.obj: .*17.* 18"):
        extract(replace(plain, rest=path))
    write_obj(path, rest.vertices, rest.faces[:, [1, 2, 0]])
    with pytest.raises(InputError, match=r"rest\.obj: .*triangle 0"):
        extract(replace(plain, rest=path))


def test_vertices_of_weight_zero_are_missing_data(plain, folder, animation, write_obj):
    weights = np.linspace(1, 2, 18)
    weights[[4, 11]] = 0
    np.save("weights.npy", weights)
    rest = write_obj(folder / "rest.obj", animation.frames[0], animation.rest.faces)
    settings = replace(plain, vertex_weights=Path("weights.npy"), rest=rest)
    clean = extract(settings)
    with h5py.File(clean.path) as file:
        expected = file["verts"][:]
    for k, vertices in enumerate(animation.frames, start=1):
        wild = vertices.copy()
        wild[[4, 11]] = 1000.0 * k
        write_obj(folder / "frames" / f"frame_{k}.obj", wild, animation.rest.faces)
    assert np.abs(cages_of(settings) - expected).max() <= 1e-12
    again = extract(settings)
    for name in ("rms", "max_deviation", "worst_vertex", "spread"):
        found, known = (getattr(result.metrics, name) for result in (again, clean))
        np.testing.assert_allclose(found, known, rtol=1e-9, atol=1e-12)
    assert "weights.npy" in again.sources["vertex_weights"]["name"]
    assert np.isnan(again.metrics.volume).all()
    assert np.isnan(again.metrics.volume_reconstructed).all()
    note, _ = texts(again.notes)
    assert note.startswith("2 vertices of weight 0 are missing data, so volumes")
    assert "volume change  not defined, " in format_text(build_report(again))


@pytest.mark.parametrize(
    ("weights", "says"),
    [
        (np.ones(17), "(17,)"),
        (np.eye(18)[3] - 1, "vertex 0 is -1"),
        (np.full(18, np.nan), "vertex 0 is nan"),
        (np.zeros(18), "zero"),
    ],
)
def test_unusable_vertex_weights_are_refused_with_their_file(plain, weights, says):
    np.save("weights.npy", weights)
    with pytest.raises(InputError) as caught:
        extract(replace(plain, vertex_weights=Path("weights.npy")))
    assert str(caught.value).startswith("weights.npy: ")
    assert says in str(caught.value)


def test_cages_move_with_rigidly_moved_frames(plain, animation):
    def clip(name, frames):
        np.savez(name, verts=frames, faces=animation.rest.faces)
        return cages_of(replace(plain, frames=(name,), rest=Path("frames/frame_1.obj")))

    still = clip("still.npz", animation.frames)
    turns = np.array([rotation(seed) for seed in range(5)])
    shifts = np.random.default_rng(7).normal(size=(5, 1, 3)) * 100
    moved = clip("moved.npz", animation.frames @ turns + shifts)
    assert np.abs(moved - (still @ turns + shifts)).max() <= 1e-9 * animation.rest.diagonal


def test_cages_scale_with_the_scene(plain, folder, animation, write_obj):
    still = cages_of(plain)
    cage = write_obj(folder / "big.obj", 1000 * animation.cage.vertices, animation.cage.faces)
    np.savez("big.npz", verts=1000 * animation.frames, faces=animation.rest.faces)
    big = cages_of(replace(plain, frames=("big.npz",), cage=cage))
    assert np.abs(big / 1000 - still).max() <= 1e-9 * animation.rest.diagonal


def test_a_result_can_be_extracted_as_a_clip_of_cages(plain, folder, animation, write_obj):
    first = extract(plain)
    around = write_obj(folder / "around.obj", 3 * animation.cage.vertices, animation.cage.faces)
    again = extract(
        replace(plain, frames=("cages.h5",), cage=around, output=Path("cages of cages.h5"))
    )
    np.testing.assert_allclose(again.rest.vertices, first.cage.vertices, rtol=0, atol=1e-12)


def test_the_system_must_not_be_singular(posed, folder, fixtures_folder):
    case = fixtures_folder / "broken" / "singular"
    settings = posed("surface", frames=(str(case / "frames"),))
    with pytest.raises(NumericalError, match="raise `alpha"):
        extract(replace(settings, cage=case / "cage.obj"))


def test_an_open_model_gets_a_note_and_no_volumes(plain, animation):
    np.savez("open.npz", verts=animation.frames, faces=animation.rest.faces[1:])
    result = extract(replace(plain, frames=("open.npz",)))
    assert np.isnan(result.metrics.volume).all()
    assert np.isnan(result.metrics.volume_reconstructed).all()
    note, unit = texts(result.notes)
    assert note.startswith("the model is open (3 boundary edges)")
    assert unit.startswith("no file states its unit")


def test_a_result_notes_that_nobody_states_the_unit(plain):
    """Its report says so, too, as it gives errors as lengths."""
    assert any("states its unit" in note for note in texts(build_report(extract(plain)).notes))
    stated = replace(plain, scene=SceneHints(metres_per_unit=1.0), overwrite=True)
    assert texts(extract(stated).notes) == ()
    small = replace(stated, scene=SceneHints(metres_per_unit=1e-6))
    assert any("1e-06 m" in note for note in texts(extract(small).notes))


def test_sources_and_settings_are_recorded(plain, folder):
    result = extract(plain)
    assert result.frames == tuple(f"frame_{k}.obj" for k in range(1, 6))
    assert result.sources["cage"]["name"] == "cage.obj"
    assert result.sources["rest"] == {"name": "frame_1.obj"}
    assert result.sources["frames"]["files"] == 5
    assert result.settings == {
        "alpha": 1e-3, "beta": 1.0, "align": True, "coordinates": "harmonic",
        "accuracy": "standard", "outside": "refuse", "rest_frame": 0,
        "vertex_weights": False,
    }  # fmt: skip


def test_a_listener_gets_stages_and_progress(plain, single_frame_blocks):
    listener = Listener()
    extract(plain, listener)
    in_order = list(dict.fromkeys(listener.stages))
    assert in_order == ["open", "bind", "factor", "read", "solve", "measure", "write", "try"]
    assert listener.counts[-6:] == [(18, 18), *((k, 5) for k in range(1, 6))]


@pytest.mark.parametrize("fault", ["frame", "interrupt"])
def test_a_run_that_stops_leaves_the_old_result(
    plain, folder, animation, write_obj, fault, single_frame_blocks
):
    Path("cages.h5").write_text("old")

    if fault == "frame":
        write_obj(folder / "frames/frame_5.obj", animation.frames[0] * np.nan, animation.rest.faces)
    with pytest.raises(InputError if fault == "frame" else KeyboardInterrupt):
        extract(plain, Listener(stop_at=(1, 5) if fault == "interrupt" else None))
    assert Path("cages.h5").read_text() == "old"
    assert [path.name for path in folder.glob("*.partial")] == ["cages.h5.partial"]


def test_a_rest_pose_is_triangulated_as_the_first_frame(plain, folder, animation):
    """One quad of the model is a dart in both, with its inner corner at another place."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0.3, 0.3, 0], [0, 1, 0], [0.2, 0.2, -1]])

    def write(name, dart):
        points = "".join("v {} {} {}\n".format(*vertex) for vertex in dart.tolist())
        (folder / name).write_text(points + "f 2 3 4 1\nf 2 1 5\nf 3 2 5\nf 4 3 5\nf 1 4 5\n")
        return folder / name

    rest = corners.copy()
    rest[[1, 2]] = [0.3, 0.3, 0], [1, 1, 0]
    settings = replace(plain, frames=(str(write("a.obj", corners)),), rest=write("rest.obj", rest))
    faces = extract(settings).rest.faces
    np.testing.assert_array_equal(faces, extract(replace(settings, rest=None)).rest.faces)


def test_triangulation_is_noted_for_cage_rest_and_frames(plain, folder, animation):
    """A model and a cage of one box in another, both of quads."""
    sides = ("1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4")
    quads = "".join(f"f {side}\n" for side in sides)
    corners = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]

    def write(name, size):
        points = "".join(f"v {size * x} {size * y} {size * z}\n" for x, y, z in corners)
        (folder / name).write_text(points + quads)
        return folder / name

    settings = replace(
        plain,
        frames=(str(write("frame.obj", 1)),),
        rest=write("rest.obj", 1),
        cage=write("quads.obj", 2),
    )
    assert texts(extract(settings).notes)[:-1] == (
        "quads.obj: 6 polygons cut into triangles to compute with",
        "rest.obj: 6 polygons cut into triangles to compute with",
        "frame.obj: 6 polygons cut into triangles to compute with, as in all frames",
    )


@pytest.mark.parametrize("value", [1e51, 1e104, 1e160])
def test_coordinates_that_would_overflow_are_refused_before_the_old_result_goes(
    plain, folder, animation, write_obj, value
):
    Path("cages.h5").write_text("old")
    wild = animation.frames[3].copy()
    wild[7, 1] = value
    write_obj(folder / "frames/frame_4.obj", wild, animation.rest.faces)
    with pytest.raises(InputError, match=r"frame_4\.obj: .*vertex 7"):
        extract(plain)
    assert Path("cages.h5").read_text() == "old"


def test_the_largest_and_smallest_accepted_scenes_are_reported(plain, folder, animation, write_obj):
    for k, scale in enumerate((3e49, 1e-50)):
        cage = write_obj(folder / "scaled.obj", scale * animation.cage.vertices / 2.5,
                         animation.cage.faces)  # fmt: skip
        np.savez("clip.npz", verts=scale * animation.frames / 6, faces=animation.rest.faces)
        result = extract(replace(plain, frames=("clip.npz",), cage=cage))
        assert 0 < build_report(result).summary.rms_percent < 100, k
