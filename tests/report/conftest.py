"""A result on disk, and the same numbers taken from it by plain h5py."""

from dataclasses import dataclass

import h5py
import numpy as np
import pytest

from cageik_cli.extraction import extract
from cageik_cli.inputs import ExtractSettings
from cageik_cli.store.result import Result


@dataclass(frozen=True, eq=False)
class Case:
    """A result, its frames (F, m, 3), their reconstructions, and the faces."""

    result: Result
    frames: np.ndarray
    rebuilt: np.ndarray
    faces: np.ndarray


@pytest.fixture(scope="session")
def case_of(tmp_path_factory, animation, write_obj):
    """Extract frames of the little model, all or some of its faces."""

    def extracted(frames, faces):
        folder = tmp_path_factory.mktemp("case")
        np.savez(folder / "clip.npz", verts=frames, faces=faces)
        cage = write_obj(folder / "cage.obj", animation.cage.vertices, animation.cage.faces)
        result = extract(ExtractSettings((str(folder / "clip.npz"),), cage, folder / "cages.h5"))
        with h5py.File(result.path) as file:
            rebuilt = file["weights"][:] @ file["verts"][:]
        return Case(result, frames, rebuilt, faces)

    return extracted


@pytest.fixture(scope="session")
def closed(case_of, animation) -> Case:
    return case_of(animation.frames, animation.rest.faces)


@pytest.fixture(scope="session")
def opened(case_of, animation) -> Case:
    return case_of(animation.frames, animation.rest.faces[2:])
