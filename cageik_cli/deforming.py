"""The cage animation of a result, applied to its rest model or to another mesh in the cage."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
import re

import numpy as np

from cageik_cli.binding import BindSettings
from cageik_cli.binding_run import WeightSettings, made
from cageik_cli.errors import InputError, located
from cageik_cli.export import Animation, Output, Written, write_animation
from cageik_cli.mesh import Floats, TriMesh
from cageik_cli.observer import Observer
from cageik_cli.scene import Scene, SceneHints
from cageik_cli.sequence import (
    ClipSettings,
    LoadedMesh,
    MeshSequence,
    load_mesh,
    open_sequence,
    refuse_other_connectivity,
)
from cageik_cli.store.result import Result, read_cages, read_result, read_weights
from cageik_cli.threads import blas_threads

LARGEST_BLOCK = 16
"""Frames to a product at most; it gains nothing from more."""

ARRAYS_PER_FRAME = 4
"""Arrays (m, 3) that a frame has at once: the product, in the order of frames, as written."""
