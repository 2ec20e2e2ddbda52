"""The style of plots: their colours and fonts, whatever the user's matplotlibrc says."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
import matplotlib.style
from matplotlib.font_manager import FontProperties, findfont, get_font

PLOT_COLOURS = {"ink": "#20242a", "muted": "#59626d", "gap": "#eceef0", "handle": "#c8321f"}
"""Colours of texts, of axes, of skipped frames, and of handles with their targets."""

CURVE_STYLES: dict[str, Any] = {
    "rms": {"color": "#0a7d4b", "linestyle": "-", "marker": "o"},
    "unfitted": {"color": "#c0641c", "linestyle": (0, (1.2, 1.2)), "marker": "d"},
    "volume_change": {"color": "#1f4fa3", "linestyle": (0, (3.4, 1.1)), "marker": "s"},
    "max_deviation": {"color": "#8a3a8f", "linestyle": (0, (4, 1, 1, 1)), "marker": "^"},
}
"""How the curves of the error plot look, by metric; `rms` is the error of a frame."""

PANEL_SIDE = 345.6
"""Width and height of the picture of a model in a plot, in points, 72 per inch."""

DEFAULT_MAX_LENGTH = 40
"""Characters of a name that are shown; longer names are cut in the middle."""


@contextmanager
def use_fixed_style() -> Iterator[None]:
    """Set the style in which plots are drawn and saved."""
    settings: Any = {
        "font.size": 9.0,
        "axes.edgecolor": PLOT_COLOURS["muted"],
        "axes.linewidth": 0.8,
        "axes.unicode_minus": True,
        "path.simplify": False,
        "text.color": PLOT_COLOURS["ink"],
        "text.parse_math": False,
        "xtick.color": PLOT_COLOURS["muted"],
        "svg.fonttype": "none",
        "svg.hashsalt": "cageik",
    }
    with matplotlib.style.context("default"), mpl.rc_context(settings):
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
