"""Small files that would take gigabytes or minutes are refused before they do."""

import gzip
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import h5py
import numpy as np
import pytest

from tests.measured import run_measured

MOST_MEMORY = 1 << 30
MOST_SECONDS = 120
"""Far above what is measured (docs/untrusted-files.md), for machines that are busy."""

pytestmark = pytest.mark.skipif(not hasattr(os, "wait4"), reason="no figures of a process")


def gzipped_text(line, count):
    with gzip.open("bomb.obj.gz", "wb") as file:
        for _ in range(count // 1000):
            file.write(line * 1000)
    return ["info", "bomb.obj.gz"]


def gzipped_vertices():
    return gzipped_text(b"v 0 0 0\n", 8_000_000)


def gzipped_faces():
    return gzipped_text(b"f 1 1 1\n", 8_000_000)


def gzipped_polygons():
    return gzipped_text(b"f 1 2 3 4 5 6 7 8 9\n", 3_000_000)


def gzipped_zeros():
    return gzipped_text(b"\0", 1_000_000_000)


def write_shared(make):
    """Write one long text many times, as one text in the file: as an attribute or a dataset."""
    count, long = 3000, "Q" * 4_000_000
    with h5py.File("bomb.h5", "w") as file:
        make(file, np.array([long, *["x"] * (count - 1)], object))
    data = bytearray(Path("bomb.h5").read_bytes())
    size = len(long).to_bytes(4, "little")
    heaps = (heap.to_bytes(8, "little") for heap in _find_all(data, b"GCOL"))
    start = next(place for heap in heaps if (place := data.find(size + heap)) >= 0)
    data[start : start + 16 * count] = data[start : start + 16] * count
    Path("bomb.h5").write_bytes(data)


def _find_all(data, part):
    place = data.find(part)
    while place >= 0:
        yield place
        place = data.find(part, place + 1)


def shared_attribute():
    def make(file, texts):
        file.attrs.create("format", texts, dtype=h5py.string_dtype())

    write_shared(make)
    with h5py.File("bomb.h5", "r") as file:
        assert file.attrs.get_id("format").shape == (3000,)
    return ["info", "bomb.h5"]


def shared_frame_names():
    subprocess.run(
        [sys.executable, "-m", "cageik_cli", "extract", "frames", "--cage", "cage.obj", "-q"],
        check=True,
    )

    def make(file, texts):
        with h5py.File("cages.h5") as source:
            for name in source:
                source.copy(name, file)
            file.attrs.update(source.attrs)
        count = len(texts)
        for name in list(file["metrics"]):
            values = file[f"metrics/{name}"][:]
            if len(values) == 5:
                del file[f"metrics/{name}"]
                file[f"metrics/{name}"] = np.resize(values, count)
        cages = file["verts"][:]
        del file["verts"], file["frames/name"]
        file["verts"] = np.resize(cages, (count, *cages.shape[1:]))
        file.create_dataset("frames/name", data=texts, dtype=h5py.string_dtype())

    write_shared(make)
    return ["info", "bomb.h5"]


def npz_member():
    frames = 4_000
    with (
        zipfile.ZipFile("bomb.npz", "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("verts.npy", "w", force_zip64=True) as file,
    ):
        header = {"descr": "<f4", "fortran_order": False, "shape": (frames, 80_000, 3)}
        np.lib.format.write_array_header_1_0(file, header)
        for _ in range(frames):
            file.write(bytes(960_000))
    return ["info", "bomb.npz"]


def faces_of_a_clip():
    with h5py.File("bomb.h5", "w") as file:
        file["verts"] = np.random.default_rng(0).normal(size=(2, 9, 3)).astype("f4")
        faces = file.create_dataset(
            "tris", (200_000_000, 3), "i4", chunks=(4_000_000, 3), compression="gzip"
        )
        faces[:4_000_000] = np.tile([[0, 1, 2]], (4_000_000, 1))
        for k in range(4_000_000, 200_000_000, 4_000_000):
            faces.id.write_direct_chunk((k, 0), faces.id.read_direct_chunk((0, 0))[1])
    return ["info", "bomb.h5"]


def usd_references():
    pytest.importorskip("pxr")
    depth, lines = 9, ["#usda 1.0"]
    for k in range(depth):
        inside = " ".join(f'def "a{j}" (references = </P{k + 1}>) {{}}\n' for j in range(10))
        lines += [f'def Xform "P{k}" {{', inside, "}"]
    Path("bomb.usda").write_text("\n".join([*lines, f'def Mesh "P{depth}" {{}}\n']))
    return ["info", "bomb.usda"]


def usd_references_of_files():
    pytest.importorskip("pxr")
    for k in range(9):
        inside = "".join(f'def "a{j}" (references = @b{k + 1}.usda@</A>) {{}}\n' for j in range(10))
        Path(f"b{k}.usda").write_text(f'#usda 1.0\ndef Xform "A" {{\n{inside}}}\n')
    Path("b9.usda").write_text('#usda 1.0\ndef Mesh "A" {}\n')
    Path("bomb.usda").symlink_to("b0.usda")
    return ["info", "bomb.usda"]


def usd_variants():
    pytest.importorskip("pxr")
    depth, lines = 9, ["#usda 1.0"]
    for k in range(depth):
        inside = "".join(
            f'def "a{j}" (\nvariants = {{ string v = "x" }}\nprepend variantSets = "v"\n)\n'
            f'{{\nvariantSet "v" = {{\n"x" (payload = </P{k + 1}>) {{\n}}\n}}\n}}\n'
            for j in range(10)
        )
        lines += [f'def Xform "P{k}" {{', inside, "}"]
    Path("bomb.usda").write_text("\n".join([*lines, f'def Mesh "P{depth}" {{}}\n']))
    return ["info", "bomb.usda"]


def usd_chain():
    pytest.importorskip("pxr")
    lines = [f'def Xform "P{k}" (references = </P{k + 1}>) {{}}' for k in range(5000)]
    Path("bomb.usda").write_text("\n".join(["#usda 1.0", *lines, 'def Mesh "P5000" {}\n']))
    return ["info", "bomb.usda"]


def dotted_key():
    Path("bomb.toml").write_text(".".join("a" * 30_000) + " = 1\n")
    return ["extract", "frames", "--cage", "cage.obj", "--config", "bomb.toml"]


def dotted_quoted_key():
    Path("bomb.toml").write_text(" . ".join(['"a"'] * 15_000) + " = 1\n")
    return ["extract", "frames", "--cage", "cage.obj", "--config", "bomb.toml"]


def dotted_table():
    Path("bomb.toml").write_text("[" + ".".join("a" * 30_000) + "]\nb = 1\n")
    return ["extract", "frames", "--cage", "cage.obj", "--config", "bomb.toml"]


def large_options():
    Path("bomb.toml").write_text("[extract]\n" + "".join(f"a{k} = 1\n" for k in range(200_000)))
    return ["extract", "frames", "--cage", "cage.obj", "--config", "bomb.toml"]


def empty_handles():
    Path("bomb.json").write_text('{"handles": [' + ",".join(["{}"] * 600_000) + "]}")
    Path("rest.obj").symlink_to("frames/frame_1.obj")
    return ["pose", "rest.obj", "bomb.json", "--cage", "cage.obj", "-o", "out.obj"]


def empty_layers():
    Path("bomb.json").write_text("[" + ",".join(["{}"] * 600_000) + "]")
    Path("rest.obj").symlink_to("frames/frame_1.obj")
    return ["pose", "rest.obj", "bomb.json", "--cage", "cage.obj", "-o", "out.obj"]


BOMBS = [
    gzipped_vertices, gzipped_faces, gzipped_polygons, gzipped_zeros, shared_attribute,
    shared_frame_names, npz_member, faces_of_a_clip, usd_references, usd_references_of_files,
    usd_variants, usd_chain, dotted_key, dotted_quoted_key, dotted_table, large_options,
    empty_handles, empty_layers,
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("make", BOMBS)
def test_a_small_file_takes_little_memory_and_is_refused(folder, make):
    found = run_measured(make(), RLIMIT_CPU=MOST_SECONDS)
    said = found.text.splitlines()[-1]
    assert found.code in (1, 2), said
    assert said.startswith("Error: ")
    assert "bomb" in said
    assert "internal error" not in said
    assert found.size < MOST_MEMORY
