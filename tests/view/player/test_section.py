"""The data of a player gives the frames of `cageik deform`, and its bar of time their errors."""

import re
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.weights.binding import Binding, Poses, reconstruct_frames
from cageik_cli.store.result import read_binding, read_cages, read_rotations
from cageik_cli.view.player import clip as clip_module
from cageik_cli.view.player import section
from cageik_cli.view.player.clip import load_player_clip, make_single_pose
from cageik_cli.view.player.compression import SMALL_MAX_LEVEL, decimate
from cageik_cli.view.player.section import (
    MAX_TIMELINE_COLUMNS,
    MIN_COLUMN_HEIGHT,
    build_payload,
    build_timeline,
    draw_columns,
    list_frame_errors,
    render_player_page,
    render_view_page,
)
from tests.shapes import ball, box, quad_box, rotation
from tests.view.player.rebuild import rebuild_frame, unpack_payload


def _check_frames(result, found):
    """Compare rebuilt frames with those that deform writes."""
    binding = read_binding(result)
    cages = np.concatenate(list(read_cages(result, 100)))
    wanted = reconstruct_frames(binding, Poses(cages, read_rotations(result)))
    for frame, mesh in enumerate(wanted):
        distances = np.linalg.norm(found(frame) - mesh, axis=1) / result.rest.diagonal
        assert np.sqrt((distances**2).mean()) < 1e-5
        assert distances.max() < 1e-4


@pytest.mark.parametrize(
    "options",
    [{}, {"rank": 3}, {"influences": 4}],
    ids=["all weights", "low rank", "few influences with offsets"],
)
def test_fitted_frames_are_those_of_deform(make_fitted, options):
    result = make_fitted(**options)
    assert result.has_offsets == ("influences" in options)
    text = build_payload(load_player_clip(result))
    _check_frames(result, lambda frame: rebuild_frame(text, frame))


def test_frames_are_those_of_deform(closed, clip):
    text = build_payload(clip)
    _check_frames(closed.result, lambda frame: rebuild_frame(text, frame))
    with pytest.raises(AssertionError):
        _check_frames(closed.result, lambda frame: rebuild_frame(text, 0))


def test_a_small_page_is_rounded_and_holds_no_input(closed):
    result = closed.result
    page = render_player_page(result)
    text = page.split('id="player-data">')[1].split("<")[0]
    header, arrays = unpack_payload(text)
    assert (header["held"], "held" in arrays) == ([], False)
    assert np.abs(arrays["weights"]).max() <= SMALL_MAX_LEVEL
    assert len(page) < len(render_view_page(load_player_clip(result)))
    binding, cages = read_binding(result), np.concatenate(list(read_cages(result, 100)))
    wanted = reconstruct_frames(binding, Poses(cages, read_rotations(result)))
    found = [rebuild_frame(text, frame) for frame in range(len(wanted))]
    distances = np.linalg.norm(found - wanted, axis=2) / result.rest.diagonal
    assert np.sqrt((distances**2).mean()) < 2e-4
    assert render_player_page(result) == page


def test_a_model_far_from_the_origin_is_as_precise(clip):
    binding = clip.binding
    away, turn = np.array([1e7, -2e7, 3e7]), rotation(2)
    far = Binding(
        TriMesh(binding.rest.vertices + away, binding.rest.faces),
        TriMesh(binding.cage.vertices + away, binding.cage.faces),
        binding.weights,
    )
    cages = (clip.cages[-1] - clip.cages[0].mean(axis=0)) @ turn + away
    moved = replace(clip, binding=far, base=clip.base + away, cages=cages[None],
                    rotations=turn[None])  # fmt: skip
    found = rebuild_frame(build_payload(moved), 0)
    wanted = far.weights @ (cages - away) + away
    assert np.abs(found - wanted).max() / far.rest.diagonal < 3e-5


@pytest.mark.parametrize("record", ["Header", "Arrays"])
def test_the_types_of_the_script_name_what_a_page_holds(clip, record):
    types = (files("cageik_cli.view") / "templates" / "player.d.ts").read_text()
    body = types.split(f"interface {record} {{")[1].split("\n}")[0]
    fields = dict(re.findall(r"^  (\w+)(\??):", body, re.MULTILINE))
    header, arrays = unpack_payload(build_payload(clip))
    found = {"Header": header, "Arrays": arrays}[record]
    assert set(found) <= set(fields)
    required = {name for name, mark in fields.items() if not mark} - {"arrays"}
    assert required <= set(found)


def test_the_same_clip_gives_the_same_bytes(closed, clip):
    assert build_payload(load_player_clip(closed.result)) == build_payload(clip)


def test_inputs_of_held_frames_are_held(closed, clip):
    header, arrays = unpack_payload(build_payload(clip))
    assert header["held"][0]["label"] == "worst"
    for place, one in enumerate(header["held"]):
        errors = arrays["held"][place].T * header["heldStep"] * closed.result.rest.diagonal
        mesh = closed.reconstruction[one["frame"]] + errors
        np.testing.assert_allclose(mesh, closed.frames[one["frame"]], atol=1e-4)


def test_the_error_of_each_vertex_is_held(closed, clip):
    rms = clip.vertex_rms.copy()
    rms[3] = np.nan
    header, arrays = unpack_payload(build_payload(replace(clip, vertex_rms=rms)))
    assert arrays["rms"][3] == 65535
    known = np.delete(np.arange(len(rms)), 3)
    found = arrays["rms"][known] * header["rms"]["top"] / 65534
    np.testing.assert_allclose(found, rms[known], atol=header["rms"]["top"] / 65534)
    assert 0 < header["rms"]["end"] < 10 * header["rms"]["top"]


def test_the_worst_place_is_the_largest_deviation(closed, clip):
    result = closed.result
    header, _ = unpack_payload(build_payload(clip))
    if not result.regions:
        worst = int(result.metrics.max_deviation.argmax())
        assert header["focus"]["frame"] == worst
        assert header["focus"]["vertex"] == result.metrics.worst_vertex[worst]
    else:
        assert header["focus"]["frame"] == result.regions[0].frame
        assert header["focus"]["vertex"] == result.regions[0].worst_vertex


def test_a_single_pose_is_exact_at_rest(clip):
    text = build_payload(make_single_pose(clip.binding, ["model.obj", "--cage", "cage.obj"]))
    header, _ = unpack_payload(text)
    assert (header["isClip"], header["frames"], header["held"]) == (False, [], [])
    np.testing.assert_allclose(rebuild_frame(text, 0), clip.binding.rest.vertices, atol=1e-6)


def test_a_large_model_is_decimated(clip, monkeypatch):
    monkeypatch.setattr(section, "MAX_DRAWN_VERTICES", 12)
    header, arrays = unpack_payload(build_payload(clip))
    drawn = arrays["vertices"].astype(int)
    assert len(drawn) == arrays["lack"].shape[1] <= 12 < header["vertexCount"]
    found = rebuild_frame(build_payload(clip), 2)
    np.testing.assert_allclose(found, (clip.binding.weights @ clip.cages[2])[drawn], atol=1e-4)
    rest = clip.binding.rest.vertices
    nearest = drawn[header["focus"]["vertex"]]
    distances = np.linalg.norm(rest[drawn] - rest[clip.focus["vertex"]], axis=1)
    assert np.linalg.norm(rest[nearest] - rest[clip.focus["vertex"]]) == distances.min()


def test_a_large_cage_leaves_fewer_vertices(clip, monkeypatch):
    monkeypatch.setattr(section, "MAX_WEIGHTS", 8 * len(clip.binding.cage.vertices))
    assert len(section.choose_vertices(clip.binding.rest, clip.binding.cage)[0]) <= 8


def test_the_end_of_a_long_clip_is_left_out(closed, clip, monkeypatch):
    monkeypatch.setattr(clip_module, "MAX_CAGE_NUMBERS", 3 * clip.binding.cage.vertices.size + 1)
    short = load_player_clip(closed.result)
    assert (len(short.cages), short.left_out) == (3, len(clip.cages) - 3)
    assert short.frames == clip.frames[:3]
    assert all(frame < 3 for frame in short.held)
    assert build_payload(short)


def test_a_result_without_weights_has_no_player(closed, tmp_path):
    import h5py

    from cageik_cli.store.result import read_result

    path = tmp_path / "bare.h5"
    path.write_bytes(closed.result.path.read_bytes())
    with h5py.File(path, "a") as file:
        del file["weights"]
    assert load_player_clip(read_result(path)) is None


def test_a_player_has_the_mirror_of_a_symmetric_cage(clip):
    """One cage is a box; a vertex of the other has left its place."""
    assert "mirror" in section.list_features(clip)
    bent = clip.binding.cage.vertices.copy()
    bent[0] += [0.3, 0.2, 0.1]
    other = Binding(clip.binding.rest, clip.binding.cage.move(bent), clip.binding.weights)
    assert "mirror" not in section.list_features(replace(clip, binding=other))


@pytest.mark.parametrize("largest", [4, 50, 300])
def test_a_ball_keeps_its_shape(largest):
    mesh = ball(levels=4, size=1.0)
    vertices, faces = decimate(mesh, largest)
    assert len(vertices) <= largest < len(mesh.vertices)
    assert (np.diff(vertices) > 0).all()
    assert (np.unique(faces) < len(vertices)).all()
    kept = TriMesh(mesh.vertices[vertices], faces)
    if largest == 300:
        assert kept.is_closed
        assert kept.volume == pytest.approx(mesh.volume, rel=0.1)
        assert len(vertices) > 0.6 * largest


def test_a_mesh_that_is_small_enough_is_kept():
    mesh = ball(levels=1, size=1.0)
    vertices, faces = decimate(mesh, len(mesh.vertices))
    np.testing.assert_array_equal(vertices, np.arange(len(mesh.vertices)))
    np.testing.assert_array_equal(faces, mesh.faces)


def test_no_face_is_drawn_twice_or_without_area():
    _, faces = decimate(ball(levels=4, size=1.0), 100)
    assert (np.diff(np.sort(faces, axis=1), axis=1) > 0).all()
    first = faces.argmin(axis=1)[:, None]
    turned = np.take_along_axis(faces, (first + np.arange(3)) % 3, axis=1)
    assert len(np.unique(turned, axis=0)) == len(turned)


def test_vertices_without_faces_are_left_out():
    mesh = ball(levels=1, size=1.0)
    loose = TriMesh(np.vstack([[[9.0, 9, 9]], mesh.vertices]), mesh.faces + 1)
    vertices, _ = decimate(loose, len(mesh.vertices))
    np.testing.assert_array_equal(vertices, np.arange(1, len(mesh.vertices) + 1))


def test_triangles_that_go_on_with_a_polygon_are_marked(monkeypatch):
    """Six quads are twelve triangles; a model of triangles, or one made coarser, marks none."""
    cage, weights = quad_box(2.0), np.eye(8)
    _, arrays = unpack_payload(build_payload(make_single_pose(Binding(quad_box(), cage, weights))))
    assert arrays["joinedFaces"].tolist() == arrays["joinedCageFaces"].tolist() == [0, 1] * 6
    _, arrays = unpack_payload(build_payload(make_single_pose(Binding(box(), box(2.0), weights))))
    assert not {"joinedFaces", "joinedCageFaces"} & arrays.keys()
    monkeypatch.setattr(section, "MAX_DRAWN_VERTICES", 6)
    _, arrays = unpack_payload(build_payload(make_single_pose(Binding(quad_box(), cage, weights))))
    assert "joinedFaces" not in arrays


def test_the_error_of_each_frame_is_held_unless_it_was_skipped(closed, clip):
    rms = 100 * closed.result.metrics.rms / closed.result.rest.diagonal
    header, _ = unpack_payload(build_payload(clip))
    np.testing.assert_allclose(header["frameRms"], rms, atol=1e-6)
    errors = clip.frame_rms.copy()
    errors[2] = np.nan
    header, _ = unpack_payload(build_payload(replace(clip, frame_rms=errors)))
    assert [k for k, one in enumerate(header["frameRms"]) if one is None] == [2]


@pytest.mark.parametrize("up_axis", ["Y", "Z"])
def test_the_ground_is_at_the_lowest_point_of_the_clip(clip, up_axis):
    clip, axis = replace(clip, up_axis=up_axis), "XYZ".index(up_axis)
    text = build_payload(clip)
    lowest = min(rebuild_frame(text, k)[:, axis].min() for k in range(len(clip.cages)))
    assert clip_module.find_ground(clip) == pytest.approx(lowest, abs=1e-4)
    header, _ = unpack_payload(text)
    shift = clip.binding.cage.vertices.mean(axis=0)[axis]
    found = header["ground"] * header["diagonal"] + shift
    assert found == pytest.approx(lowest, abs=1e-4)


NUMBERS = r"M([\d.]+) 1V([\d.]+)H([\d.]+)V1z"


def read_columns(path):
    """Return left end, height and right end of each column."""
    numbers = np.array(re.findall(NUMBERS, path), float).reshape(-1, 3)
    assert len(numbers) == path.count("M")
    return numbers * [1, -1, 1] + [0, 1, 0]


def test_columns_are_as_high_as_the_errors():
    columns = read_columns(draw_columns(np.array([1.0, 4.0, 0.0, 2.0]))["error"])
    np.testing.assert_allclose(columns[:, 1], [0.25, 1, MIN_COLUMN_HEIGHT, 0.5])
    np.testing.assert_allclose(columns[:, 0], [0, 0.5, 1.5, 2.5])
    np.testing.assert_allclose(columns[:, 2], [0.5, 1.5, 2.5, 3])


def test_skipped_frames_have_full_columns_of_their_own():
    paths = draw_columns(np.array([1.0, np.nan, 2.0]))
    assert len(read_columns(paths["error"])) == 2
    np.testing.assert_allclose(read_columns(paths["skipped"]), [[0.5, 1, 1.5]])


@pytest.mark.parametrize("errors", [np.zeros(3), np.full(3, np.nan)])
def test_a_clip_without_any_error_has_its_columns(errors):
    assert sum(path.count("M") for path in draw_columns(errors).values()) == 3


def test_frames_of_a_long_clip_share_columns():
    errors = np.ones(5 * MAX_TIMELINE_COLUMNS)
    errors[7] = 10.0
    columns = read_columns(draw_columns(errors)["error"])
    assert len(columns) == MAX_TIMELINE_COLUMNS
    np.testing.assert_allclose(columns[:3, 1], [0.1, 1, 0.1])


def test_ticks_and_jumps_are_the_held_frames(clip):
    timeline = build_timeline(clip)
    assert timeline["last"] == len(clip.frames) - 1
    assert [label for label, _ in timeline["ticks"]] == [label for label, _ in clip.held.values()]
    assert [frame for frame, _ in timeline["jumps"]] == list(clip.held)
    places = [place for _, place in timeline["ticks"]]
    np.testing.assert_allclose(places, [100 * one / timeline["last"] for one in clip.held])


def test_a_single_pose_has_an_empty_bar(clip):
    pose = replace(clip, frames=(), frame_rms=None, held={})
    assert build_timeline(pose) == {"last": 0, "paths": {}, "ticks": [], "jumps": []}
    assert list_frame_errors(pose) is None
