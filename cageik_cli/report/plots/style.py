"""The style of plots: independent of pyplot and the user's matplotlibrc."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
import matplotlib.style
from matplotlib.font_manager import FontProperties, findfont, get_font

INK, MUTED = "#20242a", "#59626d"

DEFAULT_MAX_LENGTH = 40
"""Characters of a name that are shown; longer names are cut in the middle."""

MATPLOTLIB_SETTINGS: Any = {
    "font.size": 9.0,
    "axes.edgecolor": MUTED,
    "axes.linewidth": 0.8,
    "axes.unicode_minus": True,
    "path.simplify": False,
    "text.color": INK,
    "text.parse_math": False,
    "xtick.color": MUTED,
    "svg.fonttype": "none",
    "svg.hashsalt": "cageik",
}


@contextmanager
def use_fixed_style() -> Iterator[None]:
    """Set the style in which plots are drawn and saved."""
    with matplotlib.style.context("default"), mpl.rc_context(MATPLOTLIB_SETTINGS):
        yield


def make_drawable(name: str, max_length: int = DEFAULT_MAX_LENGTH) -> str:
    """Cut a long name, and replace letters that the font does not have."""
    font = get_font(findfont(FontProperties()))
    text = "".join(letter if font.get_char_index(ord(letter)) else "\ufffd" for letter in name)
    if len(text) <= max_length:
        return text
    return f"{text[: max_length // 2 - 1]}…{text[-max_length // 2 :]}"


def measure_text_width(text: str, size: float) -> float:
    """Return the width of a text in letters of this size, both in points."""
    font = get_font(findfont(FontProperties()))
    font.set_size(size, 72)
    font.set_text(text)
    return float(font.get_width_height()[0] / 64)
