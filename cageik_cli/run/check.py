"""A cage and the rest pose in it: read both, and diagnose them."""

from cageik_cli.cages.check.diagnosis import diagnose
from cageik_cli.inputs.clip import open_clip_and_choose_rest
from cageik_cli.inputs.scene import CommonScene
from cageik_cli.inputs.weights import format_repair_command
from cageik_cli.report.views.cage import CheckResult
from cageik_cli.run.settings import CheckSettings


def check_cage(settings: CheckSettings) -> CheckResult:
    """Read the cage and the rest pose, if there is one, and diagnose them."""
    is_shared = bool(settings.frames) and settings.rest is not None
    scene, rest = CommonScene(given_in=settings.given_in, is_shared=is_shared), None
    if settings.frames:
        _, rest, _ = open_clip_and_choose_rest(
            settings.frames,
            settings.clip,
            settings.rest,
            settings.rest_frame,
            scene,
            has_cage=True,
        )
    elif settings.rest is not None:
        rest = scene.open_rest(settings.rest, settings.clip.exclude)
    cage = scene.open_cage(settings.cage)
    diagnosis = diagnose(cage.mesh, rest.mesh if rest is not None else None, settings.jobs)
    command = None
    if diagnosis.is_repairable:
        command = format_repair_command(settings.cage, None if rest is None else rest.path)
    return CheckResult(cage, rest, diagnosis, command)
