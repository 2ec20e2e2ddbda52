"""The validator, where it is installed, finds faults."""

import json
import struct

import pytest

from tests.formats.gltf.khronos import KhronosValidator


def write_glb(path, **document):
    """Write a `.glb` file without a buffer."""
    text = json.dumps({"asset": {"version": "2.0"}, **document}).encode()
    text += b" " * (-len(text) % 4)
    header = struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text), len(text), b"JSON")
    path.write_bytes(header + text)
    return path


def test_the_validator_finds_a_fault_and_none_in_a_sound_file(tmp_path):
    validator = KhronosValidator()
    if not validator.is_there:
        pytest.skip("the Khronos validator is not installed: make test-gltf")
    sound = write_glb(tmp_path / "sound.glb", nodes=[{"name": "a"}])
    faulty = write_glb(tmp_path / "faulty.glb", nodes=[{"mesh": 7}])
    found = [validator.find_faults(path) for path in (sound, faulty)]
    validator.close()
    assert found[0] == []
    assert "UNRESOLVED_REFERENCE" in " ".join(found[1])
