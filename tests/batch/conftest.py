"""What an overview shows of a clip that was extracted."""

import numpy as np
import pytest

from cageik_cli.report.overview import ClipEntry, build_clip_entry
from cageik_cli.report.record import build_report
from cageik_cli.run.extraction import extract
from cageik_cli.run.settings import ExtractSettings


@pytest.fixture(scope="session")
def entry(tmp_path_factory, animation, write_obj) -> ClipEntry:
    folder = tmp_path_factory.mktemp("entry")
    np.savez(folder / "clip.npz", verts=animation.frames, faces=animation.rest.faces)
    cage = write_obj(folder / "cage.obj", animation.cage.vertices, animation.cage.faces)
    result = extract(ExtractSettings((str(folder / "clip.npz"),), cage, folder / "cages.h5"))
    return build_clip_entry(build_report(result))
