"""The compiled core, if it was built: the functions that have a body in C and one in Python.

The two bodies of a function do the same to rounding, and those that parse to the bit. Without a
compiler at installation there is no core, and Python computes; `CAGEIK_PURE=1` asks for that.
"""

import os
from typing import Any, Final

PURE_VARIABLE = "CAGEIK_PURE"


def _load_kernel() -> Any:
    """Return the module of the compiled functions, or None."""
    if os.environ.get(PURE_VARIABLE, "0") not in ("", "0"):
        return None
    try:
        from cageik_cli import _kernel
    except ImportError:
        return None
    return _kernel


kernel: Final[Any] = _load_kernel()
"""The compiled functions, or None: a function with two bodies looks here when it is called."""


def describe_core() -> str:
    """Say which body of the functions runs, and why."""
    if kernel is not None:
        return "compiled"
    if os.environ.get(PURE_VARIABLE, "0") not in ("", "0"):
        return f"Python ({PURE_VARIABLE} is set)"
    return "Python (the compiled core was not built)"
