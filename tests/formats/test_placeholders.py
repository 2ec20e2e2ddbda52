"""Files that stand for others, or came in their place: each reader says what they are."""

import gzip
import json
from pathlib import Path

import pytest

from cageik_cli.editing.cage_edits import read_cage_edits
from cageik_cli.editing.handles.reader import read_handles
from cageik_cli.formats.open import load_mesh, open_sequence
from cageik_cli.util.errors import FormatError, InputError
from cageik_cli.util.files import check_content
from tests.refusals import refused

LFS = b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a21\nsize 132735\n"
HTML = b"\n<!DOCTYPE html>\n<html><head><title>404</title></head></html>\n"

CONTENTS = {
    "Git LFS": (LFS, "is a pointer of Git LFS, not the file itself; get it by `git lfs pull`"),
    "git-annex": (b"/annex/objects/SHA256E-s9--4d7a.obj\n", "get it by `git annex get`"),
    "HTML": (HTML, "is a web page (HTML): it may be what a server has sent in place"),
    "HTML behind a comment": (b"<!-- cached -->" + HTML, "is a web page (HTML)"),
    "HTML in capitals": (b"\xef\xbb\xbf<HTML><BODY>Forbidden", "is a web page (HTML)"),
    "HTML of UTF-16": (HTML.decode().encode("utf-16"), "is a web page (HTML)"),
    "HTML of UTF-16, the other way round": (
        ("\ufeff" + HTML.decode()).encode("utf-16-be"),
        "is a web page (HTML)",
    ),
    "XML": (
        b'<?xml version="1.0"?>\n<Error><Code>AccessDenied</Code>',
        "is XML, such as a message",
    ),
    "XML alone": (b"<Error><Code>NoSuchKey</Code></Error>", "is XML, such as a message"),
    "JSON": (b'{"message": "Not Found", "status": 404}', "is JSON"),
    "JSON in lines": (b'{\r\n  "error": {}\r\n}\r\n', "is JSON"),
    "empty": (b"", "the file is empty; copy, download or export it again"),
}

SUFFIXES = (
    "obj", "ply", "off", "stl", "glb", "gltf", "usd", "usda", "usdc", "usdz", "abc", "h5", "npz",
    "npy", "mdd", "pc2", "anime", "obj.gz",
)  # fmt: skip


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_each_reader_says_what_came_in_place_of_a_file(suffix, tmp_path):
    path = tmp_path / f"clip.{suffix}"
    for data, says in CONTENTS.values():
        path.write_bytes(data)
        for read in (lambda: open_sequence([str(path)]), lambda: load_mesh(path)):
            with refused(FormatError, says, path):
                read()


def test_what_is_packed_is_looked_at_unpacked(tmp_path):
    path = tmp_path / "clip.obj.gz"
    for data, says in CONTENTS.values():
        path.write_bytes(gzip.compress(data))
        with refused(FormatError, says, path):
            load_mesh(path)


ROLES = {
    "extract FILE.obj --cage CAGE -o out.h5": "frames",
    "extract FRAMES --cage FILE.obj -o out.h5": "cage",
    "extract FRAMES --rest FILE.obj --cage CAGE -o out.h5": "rest pose",
    "extract FRAMES --binding FILE.h5 -o out.h5": "binding",
    "extract FRAMES --cage CAGE --vertex-weights FILE.npy -o out.h5": "weights of frames",
    "cage FILE.ply -o out.obj": "model",
    "check FILE.obj --cage CAGE": "model of a check",
    "report FILE.h5": "result",
    "export FILE.h5 out.mdd": "result to export",
    "deform FILE.h5 -o out.mdd": "result to deform by",
    "pose FILE.h5 HANDLES -o out.h5": "result to pose",
    "info FILE.h5": "any file",
}


@pytest.mark.parametrize("words", ROLES)
def test_files_of_all_roles_are_looked_at(words, tmp_path, monkeypatch, run):
    fixtures = Path(__file__).resolve().parents[2] / "data_fixtures" / "walker"
    names = {"FRAMES": "frames", "CAGE": "cage.obj", "HANDLES": "handles.json"}
    typed = [str(fixtures / names[word]) if word in names else word for word in words.split()]
    monkeypatch.chdir(tmp_path)
    name = next(word for word in typed if word.startswith("FILE."))
    for data, says in (CONTENTS[kind] for kind in ("Git LFS", "HTML", "XML", "JSON", "empty")):
        (tmp_path / name).write_bytes(data)
        outcome = run(*typed)
        assert outcome.code == 1, outcome
        assert outcome.err.splitlines()[-1].startswith(f"Error: {name}: {says}")


@pytest.mark.parametrize("read", [read_handles, read_cage_edits])
def test_files_of_json_may_begin_as_it_does(read, tmp_path):
    path = tmp_path / "file.json"
    for kind in ("Git LFS", "HTML", "XML", "empty"):
        data, says = CONTENTS[kind]
        path.write_bytes(data)
        with refused(FormatError, says, path):
            read(path)
    path.write_bytes(CONTENTS["JSON"][0])
    with pytest.raises(InputError) as caught:
        read(path)
    assert "is JSON" not in str(caught.value)


def test_a_buffer_of_gltf_and_a_layer_of_usd_are_looked_at(tmp_path):
    (tmp_path / "a.usda").write_text("#usda 1.0\n( subLayers = [@./below.usdc@] )\n")
    (tmp_path / "a.gltf").write_text(
        json.dumps(
            {
                "asset": {"version": "2.0"},
                "nodes": [{"mesh": 0}],
                "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
                "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
                "bufferViews": [{"buffer": 0, "byteLength": 36}],
                "buffers": [{"byteLength": 36, "uri": "below.usdc"}],
            }
        )
    )
    for kind in ("Git LFS", "HTML", "XML", "empty"):
        data, says = CONTENTS[kind]
        (tmp_path / "below.usdc").write_bytes(data)
        for name in ("a.usda", "a.gltf"):
            with refused(FormatError, f"below.usdc: {says}", tmp_path / name):
                open_sequence([str(tmp_path / name)])


def test_an_empty_file_of_options_is_one(tmp_path, run):
    (tmp_path / "empty.toml").touch()
    assert run("info", "--config", tmp_path / "empty.toml", "--help").code == 0
    (tmp_path / "pointer.toml").write_bytes(LFS)
    assert "is a pointer of Git LFS" in run("info", "--config", tmp_path / "pointer.toml", "x").err


@pytest.mark.parametrize(
    "head",
    [
        b"{\0\0\0" + bytes(40),  # 123 frames of an .anime file
        b'{"\0\0' + bytes(40),
        b"<\0\0\0",
        b"<<<<<<< HEAD\nv 0 0 0\n",
        b"# <html>\nv 0 0 0\n",
        b"version 1\n",
        b"PK\3\4",
    ],
)
def test_what_begins_alike_is_read_as_before(head):
    check_content(head)
