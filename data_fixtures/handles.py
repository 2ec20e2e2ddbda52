"""What to do to the walker: files of handles for its rest pose and for its walk."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from meshes import write_lines

Handle = dict[str, Any]

PINS: list[Handle] = [
    {"name": "right hand", "vertex": 1136, "pin": True},
    {"name": "left foot", "vertex": 994, "pin": True},
    {"name": "right foot", "vertex": 1090, "pin": True},
    {"name": "hips", "vertex": 300, "pin": True},
    {"name": "chest", "vertex": 889, "pin": True},
    {"name": "head", "vertex": 389, "pin": True},
]
GREETING: list[Handle] = [
    {"name": "left hand", "vertex": 1040, "target": [0.75, 1.75, 0.1]},
    {
        "name": "left elbow",
        "face": 1490,
        "barycentric": [0.2, 0.6, 0.2],
        "offset": [0.1, 0.1, 0.0],
    },
    *PINS,
]
"""Of the rest pose: the left arm goes up, all else stays."""

SWINGS = {
    "frames": [21, 25, 29, 33, 37],
    "values": [
        [0.2, 0.75, 0.1],
        [-0.1, 0.8, 0.15],
        [0.05, 0.7, 0.1],
        [-0.05, 0.85, 0.1],
        [0.15, 0.75, 0.1],
    ],
}
WAVE: list[Handle] = [{"name": "left hand", "vertex": 1040, "offset": SWINGS}, *PINS]
"""Of the walk: the left hand goes up and swings, all else walks on."""
SPAN = {"frames": [21, 37], "falloff": 8}


def write_handles(folder: Path) -> None:
    """Write both files."""
    write_lines(folder / "handles.json", document(GREETING, {}))
    write_lines(folder / "wave.json", document(WAVE, SPAN))


def document(handles: list[Handle], span: dict[str, Any]) -> list[str]:
    """Return a file's lines: one a handle, and one for each other setting."""
    rows = [f"    {json.dumps(handle)}" for handle in handles]
    settings = [f"  {json.dumps(name)}: {json.dumps(value)}" for name, value in span.items()]
    listed = ['  "handles": [', *_separated(rows), "  ]"]
    return ["{", *(f"{line}," for line in settings), *listed, "}"]


def _separated(rows: list[str]) -> list[str]:
    return [*(f"{row}," for row in rows[:-1]), rows[-1]]
