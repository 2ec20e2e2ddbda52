"""A mesh with skin weights, and the joints of its skin as a tree with their motion.

A skeleton has a root, limbs, and joints below. Limbs are named by their place in the rest pose, and
joints after these, as `L_upper_front_02`. Left is +x and the front is +z, as glTF has characters;
if z is up, the front is −y.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.rotations import nearest_rotations_by_svd
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import CageError
from cageik_cli.util.text import number_names

if TYPE_CHECKING:
    from scipy import sparse

MIN_WEIGHT = 1e-7
"""Smaller weights are dropped: beside a weight of 1, single precision loses them."""

JOINT_TEXT_BYTES = 600
"""Bytes that describe a joint and its motion in a .glb, about."""

CAGE_KEY = "cage"
"""Files have the aliases of joints by this key of what is not interpreted."""

MIN_JOINT_REACH = 1e-9
"""How far a joint moves a vertex, at least: a share, or a share of the size of the model."""

HEADING_LIMITS = (0.3, 0.6)
"""Cosines of half the lean of a body: it has its heading from the second on, and none below the
first, where it is turned over and the root keeps its last one."""

MIN_CENTRE_OFFSET = 0.5
"""A limb is at one side if its centre is so far from the middle, in halves of its own extent."""

HEIGHTS = ("lower", "middle", "upper")
"""The thirds of the model that the centre of a limb can be in."""


@dataclass(frozen=True, slots=True, eq=False)
class SkinWeights:
    """The k influences of each of m vertices, the strongest first.

    Attributes
    ----------
    joints : (m, k) int64
        Joints of a row differ.
    values : (m, k) float64
        Not negative, rows sum to one; a row of fewer than k influences ends in zeros.
    """

    joints: Integers
    values: Floats

    def to_dense(self, count: int) -> Floats:
        """Return the weights as a matrix (m, count) over all joints."""
        matrix = np.zeros((len(self.joints), count))
        np.put_along_axis(matrix, self.joints, self.values, axis=1)
        return matrix

    def to_sparse(self, count: int) -> "sparse.csr_array":
        """Return the weights as a sparse matrix (m, count) over all joints."""
        from scipy import sparse

        m, width = self.joints.shape
        rows = np.repeat(np.arange(m), width)
        entries = (self.values.ravel(), (rows, self.joints.ravel()))
        return sparse.csr_array(entries, shape=(m, count))


def compute_skin_weights(weights: Floats, block_rows: int = 1 << 14) -> SkinWeights:
    """Compute skin weights from cage weights, (m, n), whose rows sum to one.

    Negative ones are cut off, and the sum of the others is scaled to one.
    """
    blocks = [slice(row, row + block_rows) for row in range(0, len(weights), block_rows)]
    k = max(int((weights[rows] >= MIN_WEIGHT).sum(axis=1).max()) for rows in blocks)
    joints = np.empty((len(weights), k), np.int64)
    values = np.empty((len(weights), k))
    for rows in blocks:
        joints[rows] = np.argsort(-weights[rows], axis=1, kind="stable")[:, :k]
        largest = np.take_along_axis(weights[rows], joints[rows], axis=1)
        values[rows] = np.where(largest >= MIN_WEIGHT, largest, 0.0)
    sums = values.sum(axis=1, keepdims=True)
    if not sums.all():
        raise CageError(
            f"vertex {int(np.argmin(sums))} has no weight above zero; bind the mesh again"
        )
    return SkinWeights(joints, values / sums)


@dataclass(frozen=True, slots=True, eq=False)
class Skin:
    """A mesh with skin weights, and how the whole of it turns.

    Attributes
    ----------
    rest : TriMesh
        m vertices.
    rotations : (F, 3, 3) float64
        R of each frame; `points @ R` turns points of the rest pose to it.
    turns : iterable of (n, 3, 3) float64, optional
        R of each joint, frame by frame, which are taken once and in order; joints that only
        translate have none, and turn with the whole.
    cage_joints : (c,) int64, optional
        Which of the n joints each vertex of the cage has become; its own if absent.
    limbs : (n,) int64, optional
        Which limb, a part of the body, each joint is of, and is named by.
    has_limb_joints : bool
        Whether limbs are joints, above their own; without, all are below the root.
    error : float, optional
        The largest that the rms distance of the mesh from the input can be, percent of the
        diagonal of the rest pose; None where that is not known.
    """

    rest: TriMesh
    weights: SkinWeights
    rotations: Floats
    turns: Iterable[Floats] | None = None
    cage_joints: Integers | None = None
    limbs: Integers | None = None
    has_limb_joints: bool = True
    error: float | None = None

    @property
    def limb_count(self) -> int:
        """How many limbs are joints."""
        return int(self.limbs.max()) + 1 if self.limbs is not None and self.has_limb_joints else 0


def count_skin_bytes(skin: Skin, joint_count: int) -> int:
    """Count the bytes that a skin with normals and its motion take in single precision.

    Weights are in sets of four, joints are named by 16 bits.
    """
    joint_count += 1 + skin.limb_count  # the root, and limbs
    sets = -(-skin.weights.joints.shape[1] // 4)
    surface = (24 + sets * 4 * (4 + 2)) * len(skin.rest.vertices) + 12 * len(skin.rest.faces)
    return int(surface + joint_count * (JOINT_TEXT_BYTES + 28 * len(skin.rotations)))


class Skeleton:
    """The joints of a skin that are at `places`, (n, 3), in its rest pose.

    The root is in the mean of the joints, and turns as the whole does. If it is `extracted`, it is
    on the ground below that, moves along it and turns about the vertical only, and a joint `body`
    has the rest of the motion. If limbs are joints, each is in the mean of its own
    joints, and turns as these do on average. A skin of weights S then gives

        S c + (X − S C) R,

    with X the rest mesh, c the joints of the frame, C those at rest and R the rotation of the
    frame. If S are all the weights of a binding, this is `weights @ cage`, whatever R is. If the
    skin has turns R_j, its joints turn by them instead, and a vertex x of weights s is at
    Σ_j s_j ((x − C_j) R_j + c_j).

    Attributes
    ----------
    names : list of str
        Of J joints, those of the skin last: by their place if they turn, else as in `aliases`.
    aliases : list of str
        The vertices of the cage that each joint is, as `cage_012`; empty for the others.
    parents : (J,) int64
        Numbers of joints before; -1 for the root.
    lead : int
        Number of joints before those of the skin.
    bind_places, rest_translations : (J, 3) float64
        In the rest pose: in its space, and relative to the parent.
    turn_count : int
        The first of the joints turn, so many.
    """

    def __init__(
        self, places: Floats, skin: Skin, *, up_axis: str = "Y", is_extracted: bool = False
    ) -> None:
        self._skin, self._up, self._is_extracted = skin, "XYZ".index(up_axis), is_extracted
        self._floor = float(skin.rest.vertices[skin.rest.used_vertices, self._up].min())
        count, labels = len(places), skin.limbs
        self._members = [labels == k for k in range(skin.limb_count)]
        heads = ["root", "body"] if is_extracted else ["root"]
        last = len(heads) - 1
        self.lead = len(heads) + len(self._members)
        above = len(heads) + labels if self._members and labels is not None else last
        middle = np.full(len(self._members), last)
        self.parents = np.concatenate([np.arange(-1, last), middle, np.full(count, above)])
        self.aliases = [*[""] * self.lead, *_list_aliases(skin, count)]
        own = self.aliases[self.lead :]
        if skin.turns is not None:
            limbs = np.arange(count) if labels is None else labels
            owners = skin.weights.joints[:, 0]
            limb_names, own = name_joints(places, limbs, owners, skin.rest, up_axis)
            if labels is None:
                own = limb_names
            elif self._members:
                heads += limb_names
        self.names = number_names([*heads, *own])
        self.turn_count = self.lead if skin.turns is None else len(self.names)
        self._frame = 0
        self._turns = None if skin.turns is None else iter(skin.turns)
        self.begin_clip()
        still = np.tile(np.eye(3), (count, 1, 1))
        self.bind_places = self._place(places, np.eye(3), still)[0]
        self.rest_translations = self.bind_places.copy()
        self.rest_translations[1:] -= self.bind_places[self.parents[1:]]

    def begin_clip(self) -> None:
        """Forget the frame before, whose heading and signs the next frame would continue."""
        self._heading = 0.0
        self._last = np.tile([0.0, 0.0, 0.0, 1.0], (self.turn_count, 1))

    def advance(self, frames: Floats) -> Iterator[tuple[Floats, Floats]]:
        """Yield the joints of the next k frames, whose joints of the skin are at (k, n, 3).

        These are translations relative to the parents, (J, 3), and the quaternions of the first
        `turn_count` joints, the real part last. They have the signs that are nearer to the frame
        before, so that programs which interpolate take the short way.
        """
        from scipy.spatial.transform import Rotation

        for joints in frames:
            whole = self._skin.rotations[self._frame]
            turns = (
                np.tile(whole, (len(joints), 1, 1)) if self._turns is None else next(self._turns)
            )
            places, rotations = self._place(joints, whole, turns)
            back = rotations[self.parents[1:]].swapaxes(1, 2)
            moves = np.einsum("ja,jab->jb", places[1:] - places[self.parents[1:]], back)
            local = np.concatenate([rotations[:1], rotations[1:] @ back])[: self.turn_count]
            found = Rotation.from_matrix(local.swapaxes(1, 2)).as_quat()
            is_far = np.einsum("jq,jq->j", found, self._last) < 0
            self._last = np.where(is_far[:, None], -found, found)
            self._frame += 1
            yield np.vstack([places[:1], moves]), self._last

    def _place(self, joints: Floats, whole: Floats, turns: Floats) -> tuple[Floats, Floats]:
        """Return the places (J, 3) and rotations (J, 3, 3) of all joints, in the scene."""
        centre = joints.mean(axis=0)
        places, rotations = [centre], [whole]
        if self._is_extracted:
            ground = centre.copy()
            ground[self._up] = self._floor
            places, rotations = [ground, centre], [self._find_heading(whole), whole]
        if self._members:
            places += [joints[chosen].mean(axis=0) for chosen in self._members]
            sums = np.stack([turns[chosen].sum(axis=0) for chosen in self._members])
            rotations += list(nearest_rotations_by_svd(sums))
        return np.vstack([*places, joints]), np.concatenate([np.stack(rotations), turns])

    def _find_heading(self, rotation: Floats) -> Floats:
        """Return the part of a rotation that is about the vertical (3, 3): its twist."""
        from scipy.spatial.transform import Rotation

        quaternion = Rotation.from_matrix(rotation.T).as_quat()
        sine, cosine = quaternion[self._up], quaternion[3]
        low, high = HEADING_LIMITS
        share = np.clip((np.hypot(sine, cosine) - low) / (high - low), 0, 1)
        step = 2 * np.arctan2(sine, cosine) - self._heading
        self._heading += share * np.arctan2(np.sin(step), np.cos(step))  # the short way
        turn = Rotation.from_rotvec(self._heading * np.eye(3)[self._up])
        return np.asarray(turn.as_matrix().T)


class PosedSkin:
    """Vertices at rest, (m, 3), with weights (m, n), below the joints of a skeleton."""

    def __init__(
        self,
        vertices: NDArray[np.floating],
        weights: "sparse.csr_array",
        bind_places: Floats,
        skeleton: Skeleton,
    ) -> None:
        self.vertices, self._weights, self._skeleton = (
            vertices.astype(np.float64),
            weights,
            skeleton,
        )
        self._bind_places = bind_places

    def pose(self, moves: Floats, turns: Floats) -> Floats:
        """Return the vertices (k, m, 3), for translations (k, J, 3) and quaternions (k, T, 4)."""
        from scipy.spatial.transform import Rotation

        skeleton, (count, joint_count, _) = self._skeleton, moves.shape
        local = np.tile(np.eye(3), (count, joint_count, 1, 1))
        matrices = Rotation.from_quat(turns.reshape(-1, 4)).as_matrix().swapaxes(1, 2)
        local[:, : turns.shape[1]] = matrices.reshape(count, -1, 3, 3)
        places, rotations = moves.copy(), local
        for j, parent in enumerate(skeleton.parents.tolist()):
            if parent >= 0:
                places[:, j] = (moves[:, j, None] @ rotations[:, parent])[:, 0] + places[:, parent]
                rotations[:, j] = local[:, j] @ rotations[:, parent]
        rotations, places = rotations[:, skeleton.lead :], places[:, skeleton.lead :]
        shifts = places - np.einsum("na,knab->knb", self._bind_places, rotations)
        posed = self._multiply(shifts)
        for axis in range(3):
            posed += self.vertices[:, axis, None] * self._multiply(rotations[:, :, axis])
        return posed.reshape(len(self.vertices), count, 3).swapaxes(0, 1)

    def measure_reach(self) -> tuple[Floats, Floats]:
        """Return how far a vertex can move by a unit of each joint's translation and rotation.

        They are (J,) each: at most 1, and the distance of what follows the joint. What hardly moves
        a vertex counts as if it moved one by `MIN_JOINT_REACH`.
        """
        skeleton, count = self._skeleton, len(self._skeleton.parents)
        entries = self._weights.tocoo()
        arms = self.vertices[entries.row] - self._bind_places[entries.col]
        moves, turns = np.zeros(count), np.zeros(count)
        numbers = skeleton.lead + entries.col
        np.maximum.at(moves, numbers, entries.data)
        np.maximum.at(turns, numbers, entries.data * np.linalg.norm(arms, axis=1))
        reach = np.zeros(count)
        np.maximum.at(reach, numbers, np.linalg.norm(arms, axis=1))
        for j in range(count - 1, 0, -1):  # what is above moves all that is below
            parent = int(skeleton.parents[j])
            far = reach[j] + np.linalg.norm(skeleton.rest_translations[j])
            reach[parent] = turns[parent] = max(reach[parent], far)
            moves[parent] = 1
        size = float(np.linalg.norm(np.ptp(self.vertices, axis=0)))
        least = MIN_JOINT_REACH * (size or 1.0)
        return np.maximum(moves, MIN_JOINT_REACH), np.maximum(turns, least)

    def _multiply(self, values: Floats) -> Floats:
        """Return the weights times values of the joints, (k, n, 3), as (m, 3k)."""
        return np.asarray(self._weights @ values.swapaxes(0, 1).reshape(values.shape[1], -1))


def _list_aliases(skin: Skin, count: int) -> list[str]:
    """Return the names of the vertices of the cage that each of `count` joints is."""
    joints = np.arange(count) if skin.cage_joints is None else skin.cage_joints
    digits = max(3, len(str(len(joints) - 1)))
    names = [f"cage_{k:0{digits}}" for k in range(len(joints))]
    return [" ".join(names[k] for k in np.flatnonzero(joints == j)) for j in range(count)]


def name_joints(
    places: Floats, limbs: Integers, owners: Integers, rest: TriMesh, up_axis: str
) -> tuple[list[str], list[str]]:
    """Return the names of limbs, and of joints at `places`, (n, 3), numbered from the top down.

    Parameters
    ----------
    limbs : (n,) int64
        Limb of each joint.
    owners : (m,) int64
        Joint that each vertex of `rest` follows.
    """
    rest_places, joint_places = (
        _turn_upright(rest.vertices, up_axis),
        _turn_upright(places, up_axis),
    )
    used = rest.is_used
    box = np.stack([rest_places[used].min(axis=0), rest_places[used].max(axis=0)])
    limb_of_vertex = np.where(used, limbs[owners], -1)
    found = []
    for k in range(int(limbs.max()) + 1):
        points = rest_places[limb_of_vertex == k]
        found.append(_describe(points if len(points) else joint_places[limbs == k], box))
    limb_names = _make_names_unique(found)
    joint_names = [""] * len(places)
    step = 1e-6 * (np.ptp(box, axis=0).max() or 1)  # ties of mirrored joints are no rounding
    across, height, depth = np.round((joint_places - box.mean(axis=0)) / step).T
    order = np.lexsort([across, np.abs(across), -depth, -height])
    for k, name in enumerate(limb_names):
        chosen = order[limbs[order] == k]
        digits = max(2, len(str(len(chosen))))
        for number, joint in enumerate(chosen, start=1):
            joint_names[joint] = f"{name}_{number:0{digits}}"
    return limb_names, joint_names


def _make_names_unique(names: list[str]) -> list[str]:
    """Give the second of equal names a b, the third a c."""
    counts: dict[str, int] = {}
    found = []
    for name in names:
        counts[name] = counts.get(name, 0) + 1
        found.append(name if counts[name] == 1 else f"{name}_{chr(ord('a') + counts[name] - 1)}")
    return found


def _turn_upright(points: Floats, up_axis: str) -> Floats:
    """Return points with y up, and the front at +z."""
    return points if up_axis == "Y" else points[:, [0, 2, 1]] * [1, 1, -1]


def _describe(points: Floats, box: Floats) -> str:
    """Return where points are in a box, (2, 3), in words."""
    low, high = points.min(axis=0), points.max(axis=0)
    centre, half = (low + high) / 2, (high - low) / 2
    offset = centre - box.mean(axis=0)
    is_aside = np.abs(offset) > MIN_CENTRE_OFFSET * half
    share = (centre[1] - box[0, 1]) / (np.ptp(box[:, 1]) or 1)
    words = [HEIGHTS[int(np.clip(3 * share, 0, 2))]]
    if is_aside[0]:
        words.insert(0, "L" if offset[0] > 0 else "R")
    if is_aside[2]:
        words.append("front" if offset[2] > 0 else "back")
    return "_".join(words)
