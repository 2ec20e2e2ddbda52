"""What several tests share: the fixtures, a little animation, and ways to run the command."""

import importlib
import itertools
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import settings
from jsonschema import Draft202012Validator
from jsonschema.exceptions import best_match

from cageik_cli.batch import run as batch_run
from cageik_cli.cages.builder import build
from cageik_cli.cli import main
from cageik_cli.formats.gltf.file import GlbFile
from cageik_cli.formats.usd.writer import UsdWriter
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.inputs import weights
from cageik_cli.method.weights import harmonic
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.report.views import data, schema
from cageik_cli.run import executor
from cageik_cli.run.extraction import extract
from cageik_cli.run.settings import ExtractSettings
from cageik_cli.store.result import Result
from cageik_cli.util import compiled
from cageik_cli.util.threads import use_one_blas_thread
from cageik_cli.view import report as view_report
from tests.formats.gltf.khronos import KhronosValidator
from tests.shapes import ball, box

pytest_plugins = ("tests.results",)

EXTRACT = ("extract", "frames", "--cage", "cage.obj", "-q")
BIND = ("bind", "--cage", "cage.obj", "--rest", "frames/frame_1.obj", "-q")

# As in a process of the command. Threads of linear algebra would wait for those of other workers.
importlib.import_module("scipy.linalg")
use_one_blas_thread()

# A machine that is busy is not a fault of the code. Tests that need more examples say so.
settings.register_profile("untimed", settings.default, deadline=None, max_examples=50)
settings.load_profile("untimed")


@dataclass(frozen=True, eq=False)
class Animation:
    """Frames (F, m, 3) of a little closed model, and a box around its rest pose, frame 0."""

    rest: TriMesh
    cage: TriMesh
    frames: np.ndarray


@dataclass(frozen=True)
class Outcome:
    """What a run of the command left: its exit code, stdout and stderr."""

    code: int
    out: str
    err: str


@pytest.fixture(scope="session", autouse=True)
def unsynced_files() -> Iterator[None]:
    """No test waits for the disk: `fsync` only asks for the file."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr("os.fsync", os.fstat)
        yield


@pytest.fixture(scope="session")
def validated_files() -> Iterator[list[str]]:
    """What the validators of USD and glTF say of the files that are written in this process."""
    faults: list[str] = []
    complete_usd, complete_glb = UsdWriter.complete, GlbFile.complete
    validator = KhronosValidator()

    def validate_usd(writer: UsdWriter) -> None:
        from tests.formats.clips import faults_of  # USD is slow to import

        complete_usd(writer)
        faults.extend(f"{writer._target.name}: {fault}" for fault in faults_of(writer._target))

    def validate_glb(file: GlbFile, **scene: object) -> None:
        complete_glb(file, **scene)
        found = validator.find_faults(file._target)
        faults.extend(f"{file._target.name}: {fault}" for fault in found)

    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(UsdWriter, "complete", validate_usd)
        monkeypatch.setattr(GlbFile, "complete", validate_glb)
        yield faults
    validator.close()


@pytest.fixture(autouse=True)
def file_faults(validated_files) -> Iterator[list[str]]:
    """No test writes a file of USD or glTF that its validator refuses, unless it expects that."""
    yield validated_files
    found = validated_files.copy()
    validated_files.clear()
    assert not found


@pytest.fixture(scope="session", autouse=True)
def validated_records() -> Iterator[None]:
    """All reports and records of batches, in all tests, are as their JSON schema says."""
    validator = Draft202012Validator(json.loads(schema.format_schema()))
    with pytest.MonkeyPatch.context() as monkeypatch:
        for module in (data, view_report):
            monkeypatch.setattr(module, "format_json", _validate(data.format_json, validator))
        write = _validate(data.format_overview_json, validator)
        monkeypatch.setattr(data, "format_overview_json", write)
        monkeypatch.setitem(batch_run.REPORT_FILES, "report.json", write)
        yield


def _validate(write: Callable[..., str], validator: Draft202012Validator) -> Callable[..., str]:
    passed: set[str] = set()  # many tests report on one result

    def write_and_validate(*arguments: Any) -> str:
        text = write(*arguments)
        if text not in passed:
            best = best_match(validator.iter_errors(json.loads(text)))
            assert best is None, f"{best.json_path}: {best.message[:300]}"
            passed.add(text)
        return text

    return write_and_validate


@pytest.fixture(scope="session")
def fixtures_folder() -> Path:
    return Path(__file__).resolve().parent.parent / "data_fixtures"


@pytest.fixture(scope="session")
def animation() -> Animation:
    rest, cage = ball(levels=1, size=1.0), box(2.0)
    x, y, z = rest.vertices.T
    bend = np.stack([0.2 * x * y, -0.1 * x * x, 0.3 * y * z], axis=1)
    step = np.array([0.0, 0.5, 0.25]) + np.random.default_rng(3).normal(0, 0.02, bend.shape)
    frames = np.array([rest.vertices + k * (bend + step) for k in range(5)])
    return Animation(rest, cage, frames)


@pytest.fixture(scope="session")
def write_obj() -> Callable[[Path, np.ndarray, np.ndarray], Path]:
    """Write an OBJ file with every digit of its numbers."""

    def write(path: Path, vertices: np.ndarray, faces: np.ndarray) -> Path:
        lines = ["v {!r} {!r} {!r}".format(*vertex) for vertex in np.asarray(vertices).tolist()]
        lines += ["f " + " ".join(map(str, face)) for face in (np.asarray(faces) + 1).tolist()]
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("\n".join(lines) + "\n")
        return path

    return write


@pytest.fixture
def single_frame_blocks(monkeypatch) -> None:
    """Make each frame of a run a block, so that little clips have several."""
    monkeypatch.setattr(executor, "MAX_BLOCK_FRAMES", 1)


@pytest.fixture(scope="session")
def caches(tmp_path_factory) -> Iterator[Path]:
    """The folders of caches, one for each test; most tests never make theirs."""
    folder = tmp_path_factory.mktemp("caches")
    return (folder / f"{k}" for k in itertools.count())


@pytest.fixture(autouse=True)
def cache(caches, monkeypatch) -> Path:
    """The folder of this test's cache: no test finds what another kept, or the user's own."""
    folder = next(caches)
    monkeypatch.setenv("CAGEIK_CACHE", str(folder))
    return folder


@pytest.fixture(scope="session")
def weights_cache(tmp_path_factory) -> Path:
    """A cache for tests that bind one model to one cage again and again, and test what follows."""
    return tmp_path_factory.mktemp("weights")


@pytest.fixture(scope="session")
def character_usd(tmp_path_factory) -> Path:
    """The character of four parts as a USD file."""
    from tests.character import write_usd  # USD is slow to import

    return write_usd(tmp_path_factory.mktemp("character") / "hero.usdc")


@pytest.fixture(scope="session")
def character_result(character_usd, write_obj, weights_cache) -> Result:
    """The character of four parts, extracted with a given cage."""
    from tests.character import make_cage

    cage = make_cage()
    path = write_obj(character_usd.parent / "cage.obj", cage.vertices, cage.faces)
    settings = ExtractSettings(
        (str(character_usd),),
        path,
        character_usd.parent / "hero.h5",
        bind=BindSettings(accuracy="preview"),
        cache=weights_cache,
    )
    return extract(settings)


@pytest.fixture(autouse=True)
def no_step_summary(monkeypatch) -> None:
    """No test writes into the summary of the run that it is part of."""
    monkeypatch.delenv("GITHUB_STEP_SUMMARY", raising=False)


@pytest.fixture(params=["compiled", "python"])
def core(request, monkeypatch) -> str:
    """Run a test with the compiled body of the functions that have two, and with the other."""
    if request.param == "python":
        monkeypatch.setattr(compiled, "kernel", None)
    elif compiled.kernel is None:
        pytest.skip("the core was not compiled")
    return str(request.param)


@pytest.fixture
def coarse_panels(monkeypatch) -> None:
    """Linear densities on the cage's faces: quick, exact still on affine maps and on the cage."""
    _use_coarse_panels(monkeypatch)


def _use_coarse_panels(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cageik_cli.method.weights.harmonic.MIN_PANELS", 1)
    monkeypatch.setitem(harmonic.ACCURACIES, "standard", harmonic.Accuracy(10.0, 1, 0.0, 0))


@pytest.fixture(scope="session")
def built_cages() -> dict:
    """The cages that runs have built on coarse grids, by model and settings."""
    return {}


@pytest.fixture
def coarse_grids(monkeypatch, built_cages) -> None:
    """Build cages on coarse grids, from loose shells, in a second; runs build each once."""
    monkeypatch.setattr(build, "COARSE_GRID", (0.03, 0.13))
    monkeypatch.setattr(build, "SHELL_CANDIDATES", ((0.04, 0.08),))
    build_cage = weights._build

    def build_once(model, settings, progress):
        key = (model.vertices.tobytes(), model.faces.tobytes(), settings, build.make_shell)
        if key not in built_cages:
            built_cages[key] = build_cage(model, settings, progress)
        return built_cages[key]

    monkeypatch.setattr(weights, "_build", build_once)


@pytest.fixture(scope="session")
def tiny_clip(tmp_path_factory, animation, write_obj) -> Path:
    """A folder, read only, with `frames/frame_1.obj` to `frame_5.obj` and `cage.obj`."""
    folder = tmp_path_factory.mktemp("tiny")
    for k, vertices in enumerate(animation.frames, start=1):
        write_obj(folder / "frames" / f"frame_{k}.obj", vertices, animation.rest.faces)
    write_obj(folder / "cage.obj", animation.cage.vertices, animation.cage.faces)
    return folder


@pytest.fixture(scope="session")
def tiny_files(tmp_path_factory, tiny_clip) -> Path:
    """A folder, read only, with the `cages.h5` and the `binding.h5` of the tiny clip."""
    folder = tmp_path_factory.mktemp("tiny_files") / "run"
    shutil.copytree(tiny_clip, folder)
    with pytest.MonkeyPatch.context() as monkeypatch:
        _use_coarse_panels(monkeypatch)
        monkeypatch.setenv("CAGEIK_CACHE", str(folder / "cache"))
        monkeypatch.delenv("GITHUB_STEP_SUMMARY", raising=False)
        monkeypatch.chdir(folder)
        for words in (EXTRACT, BIND):
            assert run_in_process(*words).code == 0
    return folder


@pytest.fixture(scope="session")
def tiny_result(tiny_files) -> Path:
    """The result of the tiny clip, read only."""
    return tiny_files / "cages.h5"


@pytest.fixture(scope="session")
def tiny_binding(tiny_files) -> Path:
    """The binding of the tiny clip, read only."""
    return tiny_files / "binding.h5"


@pytest.fixture
def folder(tmp_path, monkeypatch, tiny_clip, coarse_panels) -> Path:
    """The current folder, with the files of the tiny clip."""
    shutil.copytree(tiny_clip, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def extracted(folder, tiny_result) -> Path:
    """The folder of the tiny clip, with the result `cages.h5`."""
    shutil.copy(tiny_result, folder)
    return folder


@pytest.fixture
def input_elsewhere(monkeypatch) -> None:
    """Skins follow the reconstruction, as where the input of the result is not found."""
    monkeypatch.setattr("cageik_cli.run.clips.find_input", lambda *_: None)


@pytest.fixture
def bound(extracted, tiny_binding) -> Path:
    """The folder of the tiny clip, with the result and `binding.h5`."""
    shutil.copy(tiny_binding, extracted)
    return extracted


def run_in_process(*arguments: object) -> Outcome:
    """Run the command in this process."""
    words = [str(argument) for argument in arguments]
    result = CliRunner().invoke(main, words, catch_exceptions=False)
    return Outcome(result.exit_code, result.stdout, result.stderr)


@pytest.fixture
def run() -> Callable[..., Outcome]:
    """Run the command in this process."""
    return run_in_process


@pytest.fixture
def run_process() -> Callable[..., Outcome]:
    """Run Python, or with words after `-m cageik_cli` the command, in a process of its own."""

    def start(*arguments: object, **options: object) -> Outcome:
        words = [sys.executable, *map(str, arguments)]
        environment = os.environ | {"PYTHONWARNINGS": "error"}
        done = subprocess.run(
            words, capture_output=True, text=True, timeout=120, env=environment, **options
        )
        return Outcome(done.returncode, done.stdout, done.stderr)

    return start
