"""Rigs in glTF against an evaluation number by number, and what is said of others."""

import numpy as np
import pytest

from cageik_cli.formats.open import open_sequence
from cageik_cli.formats.settings import ClipSettings
from tests.formats.gltf.evaluated import Evaluated
from tests.formats.gltf.rigs import INTERPOLATIONS, RIGS

FPS = 30.0


@pytest.mark.parametrize("suffix", [".glb", "blob.gltf", ".gltf"])
@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
@pytest.mark.parametrize("name", RIGS)
def test_frames_are_those_of_the_specification(tmp_path, name, interpolation, suffix):
    file, nodes = RIGS[name](interpolation)
    path = file.save(tmp_path / f"rig{suffix}")
    clip, expected = open_sequence([str(path)], ClipSettings(fps=FPS)), Evaluated(path)
    corners = clip.first.polygons.corners
    assert len(clip) > 5
    for k in range(len(clip)):
        time = (clip.scene.start + k) / FPS
        found = clip.read_frame(k)[corners]
        wanted = np.array([p for node in nodes for p in expected.triangles(node, time)])
        if name == "moved":  # the mirrored faces are turned
            found, wanted = (np.sort(a.reshape(-1, 3, 3), axis=1) for a in (found, wanted))
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-6 * clip.first.diagonal)
