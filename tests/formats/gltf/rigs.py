"""Small rigs of every kind, each with an animation in one of the interpolations."""

import numpy as np
from scipy.spatial.transform import Rotation

from tests.formats.gltf.built import Built

INTERPOLATIONS = ("STEP", "LINEAR", "CUBICSPLINE")


def make_keys(random, width, interpolation, is_rotation=False, count=5):
    """Uneven keys, and values at them; those of splines with tangents."""
    keys = np.cumsum(random.uniform(0.05, 0.3, count))
    if is_rotation:
        values = Rotation.random(count, random_state=3).as_quat()
        values[1::2] *= -1  # the same rotations
    else:
        values = random.normal(0, 0.5, (count, width)) + (1 if width == 3 else 0)
    if interpolation != "CUBICSPLINE":
        return keys, values
    tangents = random.normal(0, 0.5, (2, count, values.shape[1]))
    return keys, np.stack([tangents[0], values, tangents[1]], axis=1).reshape(3 * count, -1)


def make_ribbon(random, count=9):
    """Points in two rows, and the triangles between them, wound alike."""
    z = np.linspace(0, 2, count)
    points = np.concatenate([np.stack([np.full(count, x), 0 * z, z], axis=1) for x in (0, 0.4)])
    points += random.normal(0, 0.02, points.shape)
    k = np.arange(count - 1)
    faces = np.concatenate(
        [
            np.stack([k, k + count, k + 1], axis=1),
            np.stack([k + 1, k + count, k + count + 1], axis=1),
        ]
    )
    return points, faces


def split(points, faces):
    """As many vertices as corners, and no indices."""
    return points[faces.ravel()]


def add_bones(file, count, name="bone"):
    """A chain of joints along z, and their inverse bind matrices."""
    first = len(file.json["nodes"])
    for k in range(count):
        node = {"name": f"{name}_{k}", "translation": [0.02 * k, 0.0, 1.0 if k else 0.0]}
        if k + 1 < count:
            node["children"] = [first + k + 1]
        file.add("nodes", node)
    binds = np.tile(np.eye(4), (count, 1, 1))
    for k in range(count):
        binds[k, :3, 3] = -np.array([0.01 * k * (k + 1), 0, k])
    columns = binds.swapaxes(1, 2).reshape(-1, 16)
    joints = list(range(first, first + count))
    return joints, file.array(columns)


def skinned(interpolation):
    """Two skins: one whose mesh has two sets of joints, and one without inverse bind matrices."""
    random = np.random.default_rng(1)
    file = Built()
    points, faces = make_ribbon(random)
    joints, binds = add_bones(file, 6)
    file.add("nodes", {"name": "armature", "scale": [1.5] * 3, "children": [joints[0]]})
    file.add("skins", {"joints": joints, "inverseBindMatrices": binds})
    file.add("skins", {"joints": joints[::-1]})
    weights = random.dirichlet(np.ones(6), len(points))
    names = np.stack([random.permutation(6) for _ in points])
    weights, names = (np.hstack([a, np.zeros((len(a), 2))]) for a in (weights, names))
    one = {"POSITION": file.array(points)}
    for k in (0, 1):
        columns = slice(4 * k, 4 * k + 4)
        one |= {f"JOINTS_{k}": file.array(names[:, columns], "B")}
        one |= {f"WEIGHTS_{k}": file.array(weights[:, columns])}
    corners = faces.ravel()
    other = {"POSITION": file.array(0.5 * split(points, faces))}
    other |= {"JOINTS_0": file.array(names[corners, :4], "H")}
    sums = weights[corners, :4].sum(axis=1, keepdims=True)
    other |= {"WEIGHTS_0": file.array(weights[corners, :4] / sums)}
    file.add("meshes", {"primitives": [{"attributes": one, "indices": file.array(corners, "B")}]})
    file.add("meshes", {"primitives": [{"attributes": other}]})
    # Their own transforms do not count.
    file.add("nodes", {"name": "one", "mesh": 0, "skin": 0, "translation": [9, 9, 9]})
    file.add("nodes", {"name": "two", "mesh": 1, "skin": 1})
    file.animate(
        "bend",
        (1, "rotation", *make_keys(random, 4, interpolation, True), interpolation),
        (2, "translation", *make_keys(random, 3, interpolation), interpolation),
        (6, "scale", *make_keys(random, 3, interpolation), interpolation),
    )
    return file, [7, 8]


def morphed(interpolation):
    """A mesh at three nodes: with animated weights, weights of the node, weights of the mesh."""
    random = np.random.default_rng(2)
    file = Built()
    points, faces = make_ribbon(random)
    moves = random.normal(0, 0.1, (3, *points.shape))
    some = dict.fromkeys((2, 5, 11))
    places = [
        file.array(moves[0]),
        file.array(moves[1], sparse=some, is_dense=False),
        file.array(moves[2], sparse={3: [0.5, 0, 0]}),
    ]
    primitive = {"attributes": {"POSITION": file.array(points)}}
    primitive |= {"targets": [{"POSITION": place} for place in places]}
    primitive |= {"indices": file.array(faces.ravel(), "H")}
    file.add("meshes", {"primitives": [primitive], "weights": [0.25, 0.5, 0.75]})
    file.add("nodes", {"mesh": 0, "name": "animated"})
    file.add("nodes", {"mesh": 0, "name": "posed", "weights": [1, -0.5, 0.0]})
    file.add("nodes", {"mesh": 0, "translation": [0, 2, 0]})
    keys, values = make_keys(random, 3, interpolation)
    file.animate("talk", (0, "weights", keys, values.ravel(), interpolation))
    return file, [0, 1, 2]


def moved(interpolation):
    """Nodes below nodes: one with a matrix that mirrors, others animated."""
    random = np.random.default_rng(3)
    file = Built()
    points, faces = make_ribbon(random)
    mirror = np.diag([-2.0, 1, 1, 1])
    mirror[:3, 3] = [1, 2, 3]
    file.add("nodes", {"name": "mirror", "children": [1], "matrix": mirror.T.ravel().tolist()})
    file.add("nodes", {"name": "arm", "children": [2, 3], "scale": [1, 2, 3]})
    file.add("nodes", {"name": "hand", "mesh": 0, "rotation": [0, 0, 0.6, 0.8]})
    file.add("nodes", {"name": "still", "mesh": 0})
    indices = file.array(faces.ravel(), "I")
    strip = [each for k in range(9) for each in (k, k + 9)]
    fan = [0, 9, 10, 1]
    place = {"POSITION": file.array(points)}
    parts = [
        {"attributes": place, "indices": indices},
        {"attributes": {"POSITION": file.array(points[strip] + 1)}, "mode": 5},
        {"attributes": {"POSITION": file.array(points[fan] - 1)}, "mode": 6},
        {"attributes": place, "indices": file.array([0, 1], "B"), "mode": 1},
    ]
    file.add("meshes", {"primitives": parts})
    file.animate(
        "wave",
        (1, "rotation", *make_keys(random, 4, interpolation, True), interpolation),
        (2, "translation", *make_keys(random, 3, interpolation, count=4), interpolation),
        (1, "scale", *make_keys(random, 3, interpolation), interpolation),
    )
    return file, [2, 3]


def quantised(interpolation):
    """Integers for positions, displacements and weights; strided, sparse, and without indices."""
    random = np.random.default_rng(4)
    file = Built()
    points, faces = make_ribbon(random)
    points = split(points, faces)
    joints, binds = add_bones(file, 2)
    file.add("skins", {"joints": joints, "inverseBindMatrices": binds})
    file.json |= {"extensionsUsed": ["KHR_mesh_quantization"]}
    file.json |= {"extensionsRequired": ["KHR_mesh_quantization"]}
    share = (255 * points[:, 2].clip(0, 2) / 2).round() / 255
    weights = np.stack([share, 1 - share, 0 * share, 0 * share], axis=1)
    names = np.tile([0, 1, 0, 0], (len(points), 1))
    attributes = {
        "POSITION": file.array(points / 3, "h", 32767, stride=8, sparse={2: [3, 4, 5], 7: None}),
        "JOINTS_0": file.array(names, "B", stride=8),
        "WEIGHTS_0": file.array(weights, "B", 255),
    }
    move = file.array(0.3 * points / 3, "h", 32767, stride=8)
    morph = {"attributes": attributes, "targets": [{"POSITION": move}]}
    file.add("meshes", {"primitives": [morph], "weights": [0.5]})
    file.add("nodes", {"mesh": 0, "skin": 0})
    plain = {"POSITION": file.array(points / 3, "b", 127, stride=4)}
    file.add("meshes", {"primitives": [{"attributes": plain}]})
    file.add("nodes", {"mesh": 1, "scale": [3, 3, 3]})
    keys, turns = make_keys(random, 4, "LINEAR", True)
    file.animate("turn", (1, "rotation", keys, turns, "LINEAR"))
    animation = file.json["animations"][0]
    animation["samplers"][0]["output"] = file.array(turns, "h", 32767)
    if interpolation != "LINEAR":
        keys, values = make_keys(random, 3, interpolation)
        other = {"input": file.array(keys), "output": file.array(values)}
        animation["samplers"].append(other | {"interpolation": interpolation})
        target = {"node": 0, "path": "translation"}
        animation["channels"].append({"sampler": 1, "target": target})
    return file, [2, 3]


def instanced(interpolation):
    """A mesh at three places in a node that turns: rotations in 16 bits, one mirrored."""
    random = np.random.default_rng(5)
    file = Built()
    points, faces = make_ribbon(random)
    primitive = {"attributes": {"POSITION": file.array(points)}}
    file.add("meshes", {"primitives": [primitive | {"indices": file.array(faces.ravel(), "B")}]})
    turns = Rotation.random(3, random_state=6).as_quat()
    places = {
        "TRANSLATION": file.array(random.normal(0, 2, (3, 3))),
        "ROTATION": file.array(turns, "h", 32767),
        "SCALE": file.array(random.uniform(0.5, 2, (3, 3)) * [[1], [1], [-1]]),
    }
    extension = {"EXT_mesh_gpu_instancing": {"attributes": places}}
    scale = [1.0, 2.0, 0.5]
    file.add("nodes", {"name": "trees", "mesh": 0, "scale": scale, "extensions": extension})
    file.json["extensionsUsed"] = file.json["extensionsRequired"] = list(extension)
    keys, values = make_keys(random, 4, interpolation, True)
    file.animate("turn", (0, "rotation", keys, values, interpolation))
    return file, [0]


RIGS = {"skinned": skinned, "morphed": morphed, "moved": moved, "quantised": quantised}
RIGS["instanced"] = instanced
