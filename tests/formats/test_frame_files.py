"""One mesh file a frame: gaps in the numbers, and one connectivity."""

from pathlib import Path

import numpy as np
import pytest

from cageik_cli.formats.open import open_sequence
from cageik_cli.util.errors import ConnectivityError, FileAccessError, InputError
from tests.clips import frames_of
from tests.formats.polygons import MESH_KINDS, encode_polygons
from tests.refusals import refused


@pytest.mark.parametrize("kind", MESH_KINDS)
def test_every_kind_gives_the_frames(tmp_path, animation, kind):
    faces = animation.rest.faces.tolist()
    for k, vertices in enumerate(animation.frames):
        (tmp_path / f"f{k}.{kind}").write_bytes(encode_polygons(kind, vertices, faces))
    sequence = open_sequence([str(tmp_path)])
    np.testing.assert_array_equal(sequence.first.faces, faces)
    tolerance = 1e-6 if "ply" in kind else 0  # in single precision
    np.testing.assert_allclose(frames_of(sequence), animation.frames, rtol=0, atol=tolerance)


def test_a_frame_in_another_dialect_is_the_same_frame(folder, animation):
    path = folder / "frames/frame_2.obj"
    plain = frames_of(open_sequence(["frames"]))
    path.write_bytes(path.read_bytes().replace(b"\n", b" # behind\r\n").replace(b"\nf", b"\n f"))
    np.testing.assert_array_equal(frames_of(open_sequence(["frames"])), plain)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda v, f: (v, f[:, [1, 0, 2]]), "frame_4.obj: triangle 0 joins vertices"),
        (lambda v, f: (v, f[:-1]), "frame_4.obj: 31 triangles, the rest pose has 32"),
        (lambda v, f: (v[[*range(18), 0]], f), "frame_4.obj: 19 vertices, the rest pose has 18"),
        (lambda v, f: (v * [[1, 1, np.inf]], f), "frame_4.obj: vertex 0 is"),
        (lambda v, f: (v, np.where(f == 17, 18, f)), "frame_4.obj: a face names vertex 19"),
    ],
)
def test_another_connectivity_is_refused_with_the_path(folder, animation, write_obj, change, says):
    vertices, faces = change(animation.frames[3] + 1, animation.rest.faces)
    write_obj(folder / "frames/frame_4.obj", vertices, faces)
    with pytest.raises(InputError) as caught:
        frames_of(open_sequence(["frames"]))
    assert str(caught.value).startswith(str(Path("frames", says)))


DART = np.array([[0.0, 0, 0], [2, 0, 0], [0.5, 0.5, 0], [0, 2, 0]])


@pytest.mark.parametrize("kind", ["obj", "off"])
def test_polygons_are_cut_alike_in_all_frames_as_in_the_first(tmp_path, kind):
    """A dart that opens until it is convex, and bends inward elsewhere."""
    frames = [DART.copy() for _ in range(4)]
    frames[1][2], frames[2][2] = (2, 2, 0), (2, 2, 0)
    frames[2][3] = (1.2, 0.4, 0)
    for k, vertices in enumerate(frames):
        data = encode_polygons(kind, vertices, [[1, 2, 3, 0]])
        if k % 2:  # another dialect
            data = data.replace(b"\nf", b"\n# faces\nf")
        (tmp_path / f"f{k}.{kind}").write_bytes(data)
    sequence = open_sequence([str(tmp_path)])
    np.testing.assert_array_equal(frames_of(sequence), frames)
    a, b, c = (DART[corner] for corner in sequence.first.faces.T)
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()


def test_another_polygon_is_another_connectivity(tmp_path):
    for k, ring in enumerate([[1, 2, 3, 0], [0, 1, 2, 3]]):
        (tmp_path / f"f{k}.obj").write_bytes(encode_polygons("obj", DART, [ring]))
    with refused(ConnectivityError, "joins vertices 0-1-2, in the rest", at=tmp_path / "f1.obj"):
        frames_of(open_sequence([str(tmp_path)]))


def test_a_frame_that_is_cut_off_within_its_vertices_is_no_point_cloud(folder):
    path = folder / "frames/frame_4.obj"
    path.write_bytes(b"".join(path.read_bytes().splitlines(keepends=True)[:5]))
    with pytest.raises(InputError, match=r"vertices, the rest pose has 18; .*cut off, export"):
        frames_of(open_sequence(["frames"]))


def test_a_frame_that_went_away_is_refused(folder):
    sequence = open_sequence(["frames"])
    (folder / "frames/frame_5.obj").unlink()
    with pytest.raises(FileAccessError, match=r"frame_5\.obj: no such file"):
        frames_of(sequence)


def test_the_source_tells_contents_and_order(folder, animation, write_obj):
    def digest():
        sequence = open_sequence(["frames"])
        frames_of(sequence)
        return sequence.describe_source()

    before = digest()
    assert before["name"] == "frame_1.obj ... frame_5.obj"
    assert before["files"] == 5
    assert digest() == before
    write_obj(folder / "frames/frame_2.obj", animation.frames[2], animation.rest.faces)
    write_obj(folder / "frames/frame_3.obj", animation.frames[1], animation.rest.faces)
    assert digest()["sha256"] != before["sha256"]


def test_stamps_that_are_told_are_not_read_again(folder):
    told = open_sequence(["frames"])
    known = open_sequence(["frames"])
    stamps = [known.digest_or_zeros(k) for k in range(5)]
    source = known.describe_source()
    for k in range(1, 5):
        Path("frames", f"frame_{k + 1}.obj").unlink()
    told.set_digests(0, stamps)
    assert told.describe_source() == source
    told.set_digests(2, [bytes(32)])  # a frame that could not be read there: nothing is known of it
    assert told.digest_or_zeros(2) == stamps[2]
