"""What the script of a page computes from its data, in Python."""

import numpy as np

from cageik_cli.report.player.packing import unpack_arrays


def rebuild_frame(text: str, frame: int) -> np.ndarray:
    """Return the positions of a frame, (m, 3), file units."""
    header, arrays = unpack_arrays(text)
    turn = arrays["rotations"][frame].astype(float)
    moves = arrays["cages"][frame] - arrays["cage"] @ turn
    weights = arrays["weights"].T / header["levels"]
    weights += header["restStep"] * arrays["rests"].T.astype(float) @ arrays["smooth"]
    base = weights @ arrays["cage"] + header["lackStep"] * arrays["lack"].T
    mesh = base @ turn + weights @ moves
    return mesh * header["diagonal"] + header["origin"]
