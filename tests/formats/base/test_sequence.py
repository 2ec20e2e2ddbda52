"""A clip gives every frame once, in order, however it is cut into blocks and read ahead."""

import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cageik_cli.formats.base.mesh_data import check_connectivity
from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.errors import ConnectivityError, InputError
from tests.clips import frames_of, positions_of

FACES = np.array([[0, 1, 2]])


class Counted(MeshSequence):
    """Frames that hold their own number, and remember which were read."""

    suffixes = ()

    def __init__(self, count, broken=()):
        self.names = tuple(f"number {k}" for k in range(count))
        self.first = TriMesh(np.zeros((3, 3)), FACES)
        self.read = []
        self._broken = dict(broken)
        self._lock = threading.Lock()

    def read_positions(self, index):
        with self._lock:
            self.read.append(index)
        return np.asarray(self._broken.get(index, np.full((3, 3), float(index))))

    def digest(self, index):
        return b""

    def set_digests(self, start, stamps):
        raise NotImplementedError

    def describe_source(self):
        return {}


@given(st.integers(1, 30), st.integers(1, 40), st.integers(1, 4))
def test_blocks_hold_every_frame_once_in_order(count, size, jobs):
    clip = Counted(count)
    blocks = list(clip.blocks(size, jobs))
    assert [len(block.positions) for block in blocks[:-1]] == [size] * (len(blocks) - 1)
    assert 1 <= len(blocks[-1].positions) <= size
    numbers = np.concatenate([block.positions[:, 0, 0] for block in blocks])
    np.testing.assert_array_equal(numbers, np.arange(count))
    assert sorted(clip.read) == list(range(count))


def test_a_clip_can_be_gone_through_again():
    clip = Counted(5)
    first, again = (frames_of(clip) for _ in range(2))
    np.testing.assert_array_equal(first, again)


@given(st.integers(1, 5), st.integers(1, 4))
def test_no_more_than_two_blocks_are_read_ahead(size, jobs):
    clip = Counted(40)
    blocks = clip.blocks(size, jobs)
    next(blocks)
    assert max(clip.read) < 2 * size
    blocks.close()
    assert len(clip.read) <= 2 * size


@pytest.mark.parametrize("jobs", [1, 3])
@pytest.mark.parametrize(
    ("positions", "says"),
    [
        (np.zeros((4, 3)), "number 3: 4 vertices, the rest pose has 3; all must share"),
        (np.zeros((2, 3)), "number 3: 2 vertices, the rest pose has 3"),
        ([[0, 0, 0], [0, np.nan, 0], [0, 0, 0]], "number 3: vertex 1 is (0, nan, 0) and 1 of 3"),
        ([[0, 0, 0], [0, 0, 0], [-np.inf, 0, 0]], "number 3: vertex 2 is (-inf, 0, 0)"),
    ],
)
def test_a_bad_frame_is_refused_by_its_own_name(positions, says, jobs):
    clip = Counted(8, broken={3: positions})
    blocks = clip.blocks(2, jobs)
    np.testing.assert_array_equal(next(blocks).positions[:, 0, 0], [0, 1])
    with pytest.raises(InputError) as caught:
        positions_of(blocks)
    assert str(caught.value).startswith(says)
    blocks.close()  # here, and not wherever it is collected


def test_the_first_of_several_bad_frames_is_the_one_named():
    clip = Counted(8, broken={6: np.zeros((4, 3)), 5: np.zeros((5, 3))})
    with pytest.raises(ConnectivityError, match=r"^number 5: 5 vertices"):
        frames_of(clip, 8, 4)


def test_a_frame_whose_file_cannot_be_read_has_a_stamp_of_zeros():
    class Gone(Counted):
        def digest(self, index):
            raise InputError("gone")

    assert Counted(2).digest_or_zeros(1) == b""
    assert Gone(2).digest_or_zeros(1) == bytes(32)


def test_other_connectivity_is_refused_where_it_first_differs():
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4]])
    mesh = TriMesh(np.zeros((6, 3)), faces)
    check_connectivity(6, faces.copy(), mesh, "the rest pose")
    other = faces.copy()
    other[1:] += 1
    with pytest.raises(ConnectivityError, match=r"triangle 1 .* 1-3-4, .* 0-2-3 .*2 triangles"):
        check_connectivity(6, other, mesh, "the rest pose")
    with pytest.raises(ConnectivityError, match="2 triangles, the first frame has 3"):
        check_connectivity(6, faces[:2], mesh, "the first frame")
    with pytest.raises(ConnectivityError, match="5 vertices, the first frame has 6"):
        check_connectivity(5, faces, mesh, "the first frame")
