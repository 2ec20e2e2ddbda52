"""Turn a mesh animation into a cage animation.

The method is that of Savoye and Franco, *CageIK: Dual-Laplacian Cage-Based Inverse Kinematics*,
AMDO 2010. The command-line tool is `cageik`; the names below are the Python API:

- load: `load_clip`, `load_mesh`, `TriMesh`, `PointCloud`, `MeshSequence`
- check and bind: `check_cage`, `Diagnosis`, `bind`, `Binding`
- gradients of harmonic weights: `HarmonicField`
- fit weights to clips: `fit_weights`, `FitSettings`, `FittedWeights`
- build a cage: `build_cage`, `BuiltCage`
- extract: `extract` to arrays, `CageAnimation`; `extract_to_file`, `read_result`, `read_cages`,
  `Result`, `Edit`
- pose in memory: `Poser`, `Anchor`, `point_at_vertex`, `closest_point`, `pick`, `Camera`
- write files, as the commands do: `export`, `deform`, `ExportSummary`; `pose_to_file`,
  `PoseResult`; `edit_to_file`
- report: `build_report`, `Report`; `report_to_files`
- show in a notebook: `show`, `ShownPage`
- errors: `CageikError`, whose `kind` says what is at fault; `Note`: what was found or changed

Modules below this one may change without notice.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from cageik_cli.util.version import __version__ as __version__

if TYPE_CHECKING:
    from cageik_cli.cages.builder.build import BuiltCage
    from cageik_cli.cages.check.diagnosis import Diagnosis
    from cageik_cli.editing.summary import PoseResult
    from cageik_cli.fit.fitted import FittedWeights
    from cageik_cli.fit.settings import FitSettings
    from cageik_cli.formats.base.sequence import MeshSequence
    from cageik_cli.formats.write import ExportSummary
    from cageik_cli.geometry.mesh import TriMesh
    from cageik_cli.geometry.points import PointCloud
    from cageik_cli.method.points.field import HarmonicField
    from cageik_cli.method.pose.anchors import Anchor, closest_point, pick, point_at_vertex
    from cageik_cli.method.pose.camera import Camera
    from cageik_cli.method.pose.poser import Poser
    from cageik_cli.method.weights.binding import Binding
    from cageik_cli.report.record import Report
    from cageik_cli.run.api import (
        CageAnimation,
        bind,
        check_cage,
        extract,
        extract_to_file,
        load_clip,
        load_mesh,
        read_cages,
        read_result,
    )
    from cageik_cli.run.api_files import deform, edit_to_file, export, pose_to_file
    from cageik_cli.run.cage import build_cage
    from cageik_cli.run.fit import fit_weights
    from cageik_cli.store.result import Edit, Result
    from cageik_cli.util.errors import CageikError
    from cageik_cli.util.messages import Note
    from cageik_cli.view.report import build_report, report_to_files
    from cageik_cli.view.show import ShownPage, show

__all__ = [
    "Anchor",
    "Binding",
    "BuiltCage",
    "CageAnimation",
    "CageikError",
    "Camera",
    "Diagnosis",
    "Edit",
    "ExportSummary",
    "FitSettings",
    "FittedWeights",
    "HarmonicField",
    "MeshSequence",
    "Note",
    "PointCloud",
    "PoseResult",
    "Poser",
    "Report",
    "Result",
    "ShownPage",
    "TriMesh",
    "bind",
    "build_cage",
    "build_report",
    "check_cage",
    "closest_point",
    "deform",
    "edit_to_file",
    "export",
    "extract",
    "extract_to_file",
    "fit_weights",
    "load_clip",
    "load_mesh",
    "pick",
    "point_at_vertex",
    "pose_to_file",
    "read_cages",
    "read_result",
    "report_to_files",
    "show",
]

_HOMES = {
    "Anchor": "method.pose.anchors",
    "Binding": "method.weights.binding",
    "BuiltCage": "cages.builder.build",
    "CageAnimation": "run.api",
    "CageikError": "util.errors",
    "Camera": "method.pose.camera",
    "Diagnosis": "cages.check.diagnosis",
    "Edit": "store.result",
    "ExportSummary": "formats.write",
    "FitSettings": "fit.settings",
    "FittedWeights": "fit.fitted",
    "HarmonicField": "method.points.field",
    "MeshSequence": "formats.base.sequence",
    "Note": "util.messages",
    "PointCloud": "geometry.points",
    "PoseResult": "editing.summary",
    "Poser": "method.pose.poser",
    "Report": "report.record",
    "Result": "store.result",
    "ShownPage": "view.show",
    "TriMesh": "geometry.mesh",
    "build_cage": "run.cage",
    "build_report": "view.report",
    "closest_point": "method.pose.anchors",
    "deform": "run.api_files",
    "edit_to_file": "run.api_files",
    "export": "run.api_files",
    "extract": "run.api",
    "fit_weights": "run.fit",
    "pick": "method.pose.anchors",
    "point_at_vertex": "method.pose.anchors",
    "pose_to_file": "run.api_files",
    "report_to_files": "view.report",
    "show": "view.show",
}
"""Modules of the names that are not defined in `run.api`."""


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used, so that `import cageik_cli` is quick."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = import_module(f"{__name__}.{_HOMES.get(name, 'run.api')}")
    value = globals()[name] = getattr(module, name)
    return value


def __dir__() -> list[str]:
    """List the public names, also those that are not imported yet."""
    return sorted({*globals(), *__all__})
