"""The files that a page's commands find: `<!-- setup: NAME -->` before a block asks for one."""

import shutil

import h5py
import numpy as np
from click.testing import CliRunner

from cageik_cli import extract_to_file, load_mesh
from cageik_cli.cli import main
from cageik_cli.formats.obj.frames import encode_exact_obj
from tests.corruptions import corrupt
from tests.docs.pages import ROOT
from tests.shapes import box
from tests.splats import encode_rows, make_splat_rows

WALKER = ROOT / "data_fixtures" / "walker"


def link_fixtures(folder):
    """Put the project's fixtures where a clone has them."""
    (folder / "data_fixtures").symlink_to(ROOT / "data_fixtures", target_is_directory=True)


def add_damaged_frames(folder):
    """Make `frames` and `cage.obj`, the walking figure with one line of one frame cut short."""
    shutil.copytree(WALKER / "frames", folder / "frames")
    shutil.copy(WALKER / "cage.obj", folder)
    _damage(folder / "frames" / "walker_30.obj")


def add_scan(folder):
    """Make `scan.npz`, the walking figure with thrown and missing vertices, and `cage.obj`."""
    paths = [WALKER / "frames" / f"walker_{number}.obj" for number in range(1, 49)]
    frames = np.stack([_read_vertices(path) for path in paths])
    lines = paths[0].read_text().splitlines()
    corners = [[int(c.split("/")[0]) - 1 for c in w.split()[1:]] for w in lines if w[:2] == "f "]
    spoilt = corrupt("lost", corrupt("missing", corrupt("outliers", frames)))
    np.savez(folder / "scan.npz", verts=spoilt, faces=np.array(corners))
    shutil.copy(WALKER / "cage.obj", folder)


def add_model(folder):
    """Make `rest.obj` and `cage.obj`, and `handles.json` with a vertex that is not there."""
    shutil.copy(WALKER / "frames" / "walker_1.obj", folder / "rest.obj")
    shutil.copy(WALKER / "cage.obj", folder)
    text = (WALKER / "handles.json").read_text()
    (folder / "handles.json").write_text(text.replace("1040", "10400"))


def add_splats(folder):
    """Make `walker.h5`, and `scan.ply` and `splats.ply` on the figure at rest."""
    extract_to_file(WALKER / "frames", WALKER / "cage.obj", folder / "walker.h5")
    rows = make_splat_rows(load_mesh(WALKER / "frames" / "walker_1.obj"), 4000)
    (folder / "splats.ply").write_bytes(encode_rows(rows))
    scan = np.zeros(4000, [*((axis, "<f4") for axis in "xyz"), ("red", "u1")])
    for axis in "xyz":
        scan[axis] = rows[axis]
    (folder / "scan.ply").write_bytes(encode_rows(scan))


def add_character(folder):
    """Make `hero.usdc` of four meshes, `cage.obj` around it, and `tight.obj` around its body."""
    from tests.character import make_cage, write_usd  # USD is slow to import

    write_usd(folder / "hero.usdc")
    for name, radius in {"cage": 0.8, "tight": 0.56}.items():
        cage = make_cage(radius)
        (folder / f"{name}.obj").write_bytes(encode_exact_obj(cage.vertices, cage.faces))


def add_edited_cage(folder):
    """Make `edited.usdc`, the cages of `hero.h5` with Z up, as Blender writes them."""
    words = [folder / "hero.h5", folder / "edited.usdc", "--to", "m,z"]
    CliRunner().invoke(main, ["export", *map(str, words)], catch_exceptions=False)


def add_box(folder):
    """Make `frames`, every second one of the walking figure, and `box.obj` around the first."""
    (folder / "frames").mkdir()
    for number in range(1, 49, 2):
        shutil.copy(WALKER / "frames" / f"walker_{number}.obj", folder / "frames")
    vertices = _read_vertices(WALKER / "frames" / "walker_1.obj")
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    corners = (low + high) / 2 + 0.55 * (high - low) * box().vertices
    (folder / "box.obj").write_bytes(encode_exact_obj(corners, box().faces))


def add_animations(folder):
    """Make `animations`: two folders of frames, one of them damaged, and a file of two clips."""
    walker = folder / "animations" / "walker"
    walker.mkdir(parents=True)
    shutil.copy(WALKER / "cage.obj", walker)
    shutil.copy(WALKER / "frames" / "walker_1.obj", walker / "rest.obj")
    for name, numbers in {"stroll": range(1, 13), "stop": range(25, 37)}.items():
        (walker / name).mkdir()
        for number in numbers:
            shutil.copy(WALKER / "frames" / f"walker_{number}.obj", walker / name)
    _damage(walker / "stop" / "walker_30.obj")
    frames = np.array([_read_vertices(WALKER / "frames" / f"walker_{k}.obj") for k in range(1, 9)])
    with h5py.File(walker / "takes.hdf5", "w") as file:
        file["faces"] = _read_rows(walker / "rest.obj", "f", int) - 1
        file["fast"] = np.moveaxis(frames[::2], 0, 2)
        file["slow"] = np.moveaxis(frames, 0, 2)


def _damage(path):
    lines = path.read_text().splitlines(keepends=True)
    lines[192] = "v 0.5881\n"
    path.write_text("".join(lines))


def _read_vertices(path):
    return _read_rows(path, "v", float)


def _read_rows(path, keyword, number):
    lines = [line.split() for line in path.read_text().splitlines()]
    return np.array(
        [[number(word) for word in line[1:]] for line in lines if line[:1] == [keyword]]
    )


SCENES = {
    "damaged frames": add_damaged_frames,
    "scan": add_scan,
    "model": add_model,
    "box": add_box,
    "character": add_character,
    "edited cage": add_edited_cage,
    "animations": add_animations,
    "splats": add_splats,
}
