"""Inputs with one thing wrong (or odd) each, and the list of what to expect of them."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import h5py
import numpy as np
from meshes import (
    Mesh,
    box,
    box_quads,
    exact,
    face_lines,
    midpoint_subdivided,
    octahedron,
    write_lines,
)

LOW, HIGH = (-2.0, -2.0, -2.0), (2.0, 2.0, 2.0)
FRAME_2 = "frames/frame_2.obj"


@dataclass
class Case:
    """One input folder and what the command should say about it.

    Attributes
    ----------
    name : str
        The folder.
    says : list of str
        Lower-case fragments of the message.
    files : dict
        Bytes by path inside the folder.
    arguments : list of str
        The command's arguments, relative to the folder.
    code : int
        The exit code: 1 for an error, 0 for an input that only gets a note.
    """

    name: str
    says: list[str]
    files: dict[str, bytes]
    arguments: list[str] = field(
        default_factory=lambda: ["extract", "frames", "--cage", "cage.obj"]
    )
    code: int = 1

    def entry(self) -> dict[str, object]:
        """Return the case as it stands in the list."""
        return {
            "name": self.name,
            "arguments": self.arguments,
            "exit": self.code,
            "says": self.says,
        }


def text(lines: list[str]) -> bytes:
    """Return lines as a file's bytes."""
    return ("\n".join(lines) + "\n").encode()


def obj(mesh: Mesh) -> bytes:
    """Return a mesh as the bytes of an OBJ file."""
    return text([*exact(mesh.verts), *face_lines(mesh.faces)])


def model() -> Mesh:
    """Return the little model: an octahedron subdivided once, 18 vertices and 32 faces."""
    return midpoint_subdivided(octahedron(1.0))


def animation(mesh: Mesh) -> list[Mesh]:
    """Return three frames: the rest and two slight bends."""
    x, y, _ = mesh.verts.T
    bend = np.stack([y * y, np.zeros_like(x), x * y], axis=1) / 8
    return [mesh, mesh.moved(mesh.verts + bend), mesh.moved(mesh.verts + 2 * bend)]


def good(mesh: Mesh | None = None, cage: Mesh | None = None) -> dict[str, bytes]:
    """Return the files of a working input: three frames and a cage."""
    frames = animation(model() if mesh is None else mesh)
    files = {f"frames/frame_{i}.obj": obj(frame) for i, frame in enumerate(frames, start=1)}
    return files | {"cage.obj": obj(box(LOW, HIGH) if cage is None else cage)}


def with_line(data: bytes, number: int, line: str) -> bytes:
    """Return a file's bytes with one line (counted from 0) replaced."""
    lines = data.decode().splitlines()
    return text([*lines[:number], line, *lines[number + 1 :]])


def truncated(data: bytes) -> bytes:
    """Return an OBJ file cut inside its eighth vertex line, after the second number."""
    lines = data.decode().splitlines()
    return "\n".join([*lines[:7], " ".join(lines[7].split()[:3])]).encode()


def other_faces(mesh: Mesh) -> Mesh:
    """Return a mesh with two faces that name other vertices."""
    faces = mesh.faces.copy()
    faces[[3, 4]] = mesh.faces[[4, 3]][:, [1, 0, 2]]
    faces[3, 0] = (faces[3, 0] + 7) % len(mesh.verts)
    return mesh.with_faces(faces)


def swapped_frame(replacement: bytes) -> dict[str, bytes]:
    """Return a working input with its second frame replaced."""
    return good() | {FRAME_2: replacement}


def frame_cases() -> list[Case]:
    """Return the cases with a bad frame or a bad folder of frames."""
    files, name = good(), "frame_2.obj"
    cage = {"cage.obj": files["cage.obj"]}
    second = files[FRAME_2]
    more = model().moved(np.concatenate([model().verts, [[0.5, 0.5, 0.5]]]))
    noise = bytes((i * i * 7 + i // 3) % 256 if i % 5 else 0 for i in range(512))
    note = b"Frames go here.\n"
    missing = {p: d for p, d in files.items() if p != "frames/frame_3.obj"}
    missing["frames/frame_4.obj"] = files["frames/frame_3.obj"]
    folder = {path: data for path, data in files.items() if path != FRAME_2}
    faces = {path: with_line(data, 20, "f 1 99 3") for path, data in good().items()}
    return [
        Case("no_frame", ["frames: no frame found"], cage | {"frames/notes.txt": note}),
        Case(
            "missing_frame", ["frame_3.obj: missing between frame_2.obj and frame_4.obj"], missing
        ),
        Case("empty_frame", [name, "the file is empty"], swapped_frame(b"")),
        Case(
            "truncated_frame",
            [name, "line 8", "has 2 coordinates"],
            swapped_frame(truncated(second)),
        ),
        Case("binary_frame", [name, "the file is binary"], swapped_frame(noise)),
        Case("other_counts", [name, "19 vertices, the rest pose has 18"], swapped_frame(obj(more))),
        Case("other_faces", [name, "triangle 3 joins"], swapped_frame(obj(other_faces(model())))),
        Case(
            "nan_frame",
            [name, "vertex 4 is (0, nan, 1)"],
            swapped_frame(with_line(second, 4, "v 0 nan 1")),
        ),
        Case(
            "infinite_frame",
            [name, "vertex 4 is (inf, 0, 1)"],
            swapped_frame(with_line(second, 4, "v inf 0 1")),
        ),
        Case("folder_frame", [name, "is a folder"], folder | {f"{FRAME_2}/notes.txt": note}),
        Case("face_index", ["frame_1.obj", "vertex 99", "has 18"], faces | cage),
    ]


def joined(first: Mesh, second: Mesh) -> Mesh:
    """Return two meshes as one, with vertices at the same place shared."""
    number = {tuple(point): i for i, point in enumerate(first.verts.tolist())}
    fresh = [point for point in second.verts.tolist() if tuple(point) not in number]
    number |= {tuple(point): len(first.verts) + i for i, point in enumerate(fresh)}
    renamed = np.array([number[tuple(point)] for point in second.verts.tolist()], np.int32)
    verts = np.concatenate([first.verts, np.array(fresh)])
    return Mesh(verts, np.concatenate([first.faces, renamed[second.faces]]))


def with_sliver(cage: Mesh) -> Mesh:
    """Return a closed cage with one more face, whose three vertices lie on one edge."""
    a, b, c = cage.faces[0].tolist()
    middle = len(cage.verts)
    verts = np.concatenate([cage.verts, cage.verts[[a, b]].sum(axis=0, keepdims=True) / 2])
    split = [[a, middle, c], [middle, b, c], [a, b, middle]]
    return Mesh(verts, np.concatenate([np.array(split, np.int32), cage.faces[1:]]))


def flipped(cage: Mesh, count: int) -> Mesh:
    """Return a cage with its first faces turned over."""
    faces = cage.faces.copy()
    faces[:count] = faces[:count, ::-1]
    return cage.with_faces(faces)


def with_face(cage: Mesh, face: list[int]) -> Mesh:
    """Return a cage with one more face."""
    return cage.with_faces([*cage.faces.tolist(), face])


def cage_cases() -> list[Case]:
    """Return the cases with a bad or odd cage."""
    cage = box(LOW, HIGH)
    far = box((3.0, -2.0, -2.0), (5.0, 2.0, 2.0))
    touching = box((2.0, 2.0, -2.0), (4.0, 4.0, 2.0))
    corner = box((2.0, 2.0, 2.0), (4.0, 4.0, 4.0))
    small = cage.moved(np.clip(cage.verts, -2.0, 0.75))
    dented = midpoint_subdivided(cage)
    middle = int(np.flatnonzero((dented.verts == (0.0, 0.0, 2.0)).all(axis=1))[0])
    pulled = dented.verts.copy()
    pulled[middle, 2] = -3.0
    loose = cage.moved(np.concatenate([cage.verts, [[0.0, 3.0, 0.0]]]))
    bad = [
        ("open", "is open: no second face at 3 edges", cage.with_faces(cage.faces[:-1])),
        ("non_manifold", "more than two faces meet at edge", joined(cage, touching)),
        ("two_components", "has 2 components", joined(cage, far)),
        (
            "degenerate_face",
            "a vertex twice in a face: face 12; delete it",
            with_face(cage, [0, 1, 1]),
        ),
        ("zero_area", "degenerate, corners on a line, at face 2", with_sliver(cage)),
        (
            "duplicate_faces",
            "faces that repeat others: face 12; delete it",
            with_face(cage, cage.faces[0].tolist()),
        ),
        ("mixed_orientation", "has neighbours facing opposite ways at 7 edges", flipped(cage, 3)),
        ("too_small", "3 of 18 vertices of the rest pose are outside the cage", small),
        (
            "unreferenced_vertex",
            "which can move nothing: vertex 8; delete it",
            loose,
        ),
    ]
    bad += [
        ("self_crossing", "crosses or touches itself at", dented.moved(pulled)),
        ("pinched", "its parts touch in a point at vertex", joined(cage, corner)),
    ]
    odd = [
        ("inside_out", "it is used turned outward", flipped(cage, len(cage.faces))),
        ("quads", "6 polygons cut into triangles", box_quads(LOW, HIGH)),
    ]
    return [
        Case(f"cage_{name}", ["cage.obj", says], good(cage=mesh), code=code)
        for code, cases in ((1, bad), (0, odd))
        for name, says, mesh in cases
    ]


def pair_cases() -> list[Case]:
    """Return the cases whose files are fine by themselves but do not go together."""
    extract = ["extract", "frames", "--cage", "cage.obj"]
    cage = obj(box(LOW, HIGH))
    swapped = {"frames/frame_1.obj": cage, "cage.obj": obj(model())}
    rest = {"rest.obj": obj(other_faces(model()))}
    tiny = Mesh(
        np.array([[0.0, 0, 0], [0.5, 0, 0], [0, 0.5, 0], [0, 0, 0.5]]),
        np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32),
    )
    return [
        Case("swapped", ["cage.obj", "are swapped"], swapped),
        Case(
            "rest_other_connectivity",
            ["rest.obj", "triangle 3 joins", "in the first frame"],
            good() | rest,
            [*extract, "--rest", "rest.obj"],
        ),
        Case(
            "singular",
            ["the system is singular", "raise --alpha"],
            good(mesh=tiny),
            [*extract, "--alpha", "0"],
        ),
    ]


def result_file(schema: int = 1, complete: bool = True) -> bytes:
    """Return the bytes of an HDF5 file that begins like a result."""
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        file.create_dataset("verts", data=np.zeros((3, 8, 3)), track_times=False)
        file.attrs.update(format="cageik.result", schema=schema, complete=complete)
    return buffer.getvalue()


def result_cases() -> list[Case]:
    """Return the cases with a bad result file."""
    whole = result_file()
    results = [
        ("other_schema", "schema 99", result_file(schema=99)),
        ("truncated", "is not a sound hdf5 file", whole[: len(whole) * 6 // 10]),
        ("not_complete", "is not complete", result_file(complete=False)),
        ("not_hdf5", "is not an hdf5 file", b"This is no HDF5 file.\n"),
    ]
    return [
        Case(f"result_{name}", ["result.h5", says], {"result.h5": data}, ["report", "result.h5"])
        for name, says, data in results
    ]


CASES: tuple[Callable[[], list[Case]], ...] = (frame_cases, cage_cases, pair_cases, result_cases)


def write_broken(folder: Path) -> None:
    """Write every case's folder and ``cases.json``."""
    cases = [case for make in CASES for case in make()]
    for case in cases:
        for path, data in case.files.items():
            target = folder / case.name / path
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(data)
    entries = [json.dumps(case.entry()) for case in cases]
    write_lines(folder / "cases.json", ["[", *_commas(entries), "]"])


def _commas(entries: list[str]) -> list[str]:
    """Put a comma behind all lines but the last."""
    return [f"  {entry}," for entry in entries[:-1]] + [f"  {entries[-1]}"]
