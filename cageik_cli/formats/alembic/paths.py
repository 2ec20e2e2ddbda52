"""Where the meshes of parts are in an archive, and what parts are called by these paths."""

from collections import Counter
from collections.abc import Sequence
from itertools import accumulate

from cageik_cli.formats.base.writers import SHAPE_SUFFIX


def place_meshes(parts: Sequence[str], are_still: Sequence[bool]) -> list[str]:
    """Return the paths of the meshes of parts, which are at these paths.

    Programs call an object by the transform above its mesh. So a part is a transform of its name
    with the mesh below, unless it is alone below a transform whose name its own begins with, as
    in archives of such programs. A part at the top that nothing moves has no transform.
    """
    folders = [path.rpartition("/")[0] for path in parts]
    crowd = Counter(folders)
    uppers = {upper for path in parts for upper in accumulate(path.split("/")[:-1], "{}/{}".format)}
    taken, placed = set(parts), []
    for path, folder, is_still in zip(parts, folders, are_still, strict=True):
        name, above = path.rpartition("/")[2], folder.rpartition("/")[2]
        is_shape = crowd[folder] == 1 and name.startswith(above) and folder not in taken
        if path not in uppers and (is_shape if folder else is_still):
            placed.append(path)
        else:
            placed.append(f"{path}/{name}{SHAPE_SUFFIX}")
    return placed


def name_parts(meshes: Sequence[str], are_still: Sequence[bool]) -> list[str]:
    """Return the paths of parts whose meshes are at these paths.

    A mesh `NAME/NAMEShape` is the part `NAME`, where `place_meshes` puts that part there again.
    """
    parts = list(meshes)
    for k, path in enumerate(meshes):
        folder = path.rpartition("/")[0]
        if folder and path == f"{folder}/{folder.rpartition('/')[2]}{SHAPE_SUFFIX}":
            parts[k] = folder
    while True:
        placed, counts = place_meshes(parts, are_still), Counter(parts)
        lost = [
            k
            for k, path in enumerate(meshes)
            if parts[k] != path and (placed[k] != path or counts[parts[k]] > 1)
        ]
        if not lost:
            return parts
        for k in lost:
            parts[k] = meshes[k]
