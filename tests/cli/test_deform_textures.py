"""`cageik deform` to vertex animation textures: a folder of files that belong together."""

from pathlib import Path

import numpy as np
import pytest

from tests.formats.vat.shader import draw
from tests.formats.written import bytes_under

pytest.importorskip("png")
pytest.importorskip("OpenEXR")

DEFORM = ("deform", "cages.h5", "-o")


def names(folder):
    return sorted(path.name for path in Path(folder).iterdir())


def test_a_shader_draws_what_a_clip_holds(run, extracted):
    assert run(*DEFORM, "m.npz", "-q").code == 0
    outcome = run(*DEFORM, "m.vat")
    assert (outcome.code, outcome.out) == (0, "")
    assert outcome.err.startswith("wrote m.vat: 5 frames of 18 vertices, ")
    assert "m.vat: two textures of 8 × 16 texels, which round positions by up to " in outcome.err
    assert names("m.vat") == ["m-remap_info.json", "m.glb", "m_vat.png", "m_vnrm.png"]
    (found,) = draw(Path("m.vat"))
    np.testing.assert_allclose(found.positions, np.load("m.npz")["vertices"], rtol=0, atol=1e-4)


def test_a_conversion_changes_no_texture_but_for_rounding(run, extracted):
    """What is drawn is in metres with y up, whatever the frames are in."""
    assert run(*DEFORM, "plain.vat", "-q").code == 0
    assert run(*DEFORM, "turned.vat", "--to", "cm,z", "-q").code == 0
    (plain,), (turned,) = draw(Path("plain.vat")), draw(Path("turned.vat"))
    np.testing.assert_allclose(plain.positions, turned.positions, rtol=0, atol=1e-6)
    np.testing.assert_allclose(plain.normals, turned.normals, rtol=0, atol=1e-4)


def test_the_format_of_the_textures(run, extracted):
    outcome = run(*DEFORM, "m.vat", "--texture", "exr")
    assert outcome.code == 0, outcome.err
    assert "two textures of 8 × 16 texels\n" in outcome.err
    assert names("m.vat") == ["m-remap_info.json", "m.glb", "m_vat.exr", "m_vnrm.exr"]
    assert run(*DEFORM, "m.vat", "--overwrite", "-q").code == 0
    assert names("m.vat") == ["m-remap_info.json", "m.glb", "m_vat.png", "m_vnrm.png"]


@pytest.mark.parametrize("name", ["m.glb", "m.npz", "m"])
def test_textures_are_for_a_folder_of_them(run, extracted, name):
    outcome = run(*DEFORM, name, "--texture", "exr")
    assert outcome.code == 2
    said = f"--texture applies to a folder of textures, and the output is {name}; leave it out"
    assert said in " ".join(outcome.err.split())
    assert not Path(name).exists()


def test_a_folder_is_replaced_if_it_holds_nothing_else(run, extracted):
    assert run(*DEFORM, "m.vat", "-q").code == 0
    before = bytes_under(Path("m.vat"))
    outcome = run(*DEFORM, "m.vat")
    assert outcome.code == 1
    assert outcome.err.startswith("Error: m.vat: exists already")
    assert run(*DEFORM, "m.vat", "--overwrite", "-q").code == 0
    assert bytes_under(Path("m.vat")) == before
    Path("m.vat/m.glb.meta").write_text("of an engine")
    outcome = run(*DEFORM, "m.vat", "--overwrite")
    assert outcome.code == 1
    assert "Error: m.vat: holds m.glb.meta, which is none of the files" in outcome.err
    assert Path("m.vat/m.glb.meta").exists()


def test_memory_and_threads_do_not_change_the_bytes(run, extracted):
    found = []
    for words in (["--jobs", "1"], ["--jobs", "2"], ["--memory", "10K"]):
        assert run(*DEFORM, "m.vat", "--overwrite", "-q", *words).code == 0
        found.append(bytes_under(Path("m.vat")))
    assert found[0] == found[1] == found[2]


def test_a_folder_of_each_part(run, extracted, write_obj, animation):
    for name, size in (("hat", 0.3), ("cap", 0.4)):
        write_obj(Path(f"{name}.obj"), size * animation.rest.vertices, animation.rest.faces)
    words = ("--mesh", "hat.obj", "--mesh", "cap.obj", "-q")
    assert run(*DEFORM, "whole.vat", *words).code == 0
    assert [each.name for each in draw(Path("whole.vat"))] == ["hat", "cap"]
    assert run(*DEFORM, "{part}.vat", *words).code == 0
    assert names("hat.vat") == ["hat-remap_info.json", "hat.glb", "hat_vat.png", "hat_vnrm.png"]
    assert len(draw(Path("cap.vat"))) == 1
