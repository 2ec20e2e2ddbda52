"""Try an installed cageik outside its project: `python -I dist_smoke.py PROJECT`.

It imports nothing of the tests: only the wheel and its dependencies are there.
"""

import json
import subprocess
import sys
import tempfile
from importlib import metadata
from pathlib import Path

import cageik_cli
from cageik_cli import extract_to_file

COMMAND = Path(sys.executable).with_name("cageik.exe" if sys.platform == "win32" else "cageik")


def run(*words: object) -> str:
    """Run the installed command, and return what it prints."""
    done = subprocess.run([COMMAND, *map(str, words)], capture_output=True, text=True, check=True)
    return done.stdout


def main(project: Path, folder: Path) -> None:
    """Extract and report by the API and by the command, with what is installed."""
    place = Path(cageik_cli.__file__)
    assert place.is_relative_to(sys.prefix), f"{place}: is not what is installed in {sys.prefix}"
    version = metadata.version("cageik")
    assert run("--version") == f"cageik, version {version}\ncore: compiled\n", run("--version")
    walker = project / "data_fixtures" / "walker"
    result = extract_to_file(str(walker / "frames"), walker / "cage.obj", folder / "api.h5")
    assert len(result.frames) == 48
    run(
        "extract",
        walker / "frames",
        "--cage",
        walker / "cage.obj",
        "-o",
        folder / "walker.h5",
        "-q",
    )
    page, record = folder / "walker.html", folder / "walker.json"
    run("report", folder / "walker.h5", "--html", page, "--json", record, "-q")
    assert "<title>" in page.read_text(encoding="utf-8")
    summary = json.loads(record.read_text(encoding="utf-8"))["summary"]
    assert 0 < summary["rms_percent"] < 0.5, summary
    run("export", folder / "walker.h5", folder / "live", "--blender", "-q")
    assert (folder / "live" / "open_in_blender.py").stat().st_size > 0
    assert json.loads(run("report", "--schema"))["$defs"]
    assert json.loads(run("pose", "--schema"))
    print(f"cageik {version} at {place.parent}: error {summary['rms_percent']:.4f} %")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        main(Path(sys.argv[1]).resolve(), Path(temporary))
