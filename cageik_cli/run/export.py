"""Export the cages of a result in another format."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from cageik_cli.formats.base.skeleton import Skeleton, Skin
from cageik_cli.formats.base.writers import Animation, NamedClip, name_root, nest_names
from cageik_cli.formats.blender.live_cage import (
    BLENDER_SPACE,
    EXTENSION,
    SCRIPT,
    check_live_cage_writable,
    write_live_cage,
)
from cageik_cli.formats.gltf.skeleton import MAX_INFLUENCES
from cageik_cli.formats.gltf.skeleton import SkeletonWriter as GltfSkeletonWriter
from cageik_cli.formats.scene_conversion import SceneConversion
from cageik_cli.formats.settings import (
    JOINT_MOTIONS,
    ROOT_MOTIONS,
    SceneHints,
)
from cageik_cli.formats.usd.motion import MotionWriter
from cageik_cli.formats.usd.writer import SkeletonWriter as UsdSkeletonWriter
from cageik_cli.formats.usd.writer import UsdWriter
from cageik_cli.formats.write import (
    PLACEHOLDER,
    ExportSummary,
    Output,
    WriterFactory,
    check_mesh_output,
    name_part_files,
    names_parts,
    split_output,
    write_animation,
    write_mesh,
)
from cageik_cli.geometry.parts import join_meshes, split_parts
from cageik_cli.inputs.caged_model import CagedModel, report_skipped_frames
from cageik_cli.inputs.reconstruction import Reconstruction
from cageik_cli.method.weights.binding import Binding
from cageik_cli.rigs.jumps import MIN_TURN
from cageik_cli.run.clips import find_inputs, join_clips, measure_rms, name_clips, read_clips
from cageik_cli.run.rig import (
    DEFAULT_INFLUENCES,
    Rig,
    check_rig,
    count_influences,
    keeps_weights,
    make_rig,
    measure_input_rms,
)
from cageik_cli.run.settings import ExportSettings
from cageik_cli.store.result import StoredAnimation, read_animation, read_cages
from cageik_cli.util.arrays import Floats, Integers, count_frames, cut_blocks
from cageik_cli.util.errors import SettingError, add_remark, join_truncated
from cageik_cli.util.messages import Hint, join_texts, say
from cageik_cli.util.outputs import check_no_overlap
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.text import format_count, group_digits
from cageik_cli.util.threads import count_processors, limit_blas_threads

MAX_EXPORT_BYTES = 1 << 26
"""Bytes of a block of cages, at most."""

MAX_CUT_WEIGHT = 0.05
"""Weights below zero of a vertex sum to this at most where they are cut off: those of inexact
harmonic weights do, and hardly change the mesh."""


def export(settings: ExportSettings, progress: ProgressListener | None = None) -> ExportSummary:
    """Write the cage animation of a result, or one skeleton with the motions of several."""
    progress = progress or ProgressListener()
    check_export(settings)
    results = [read_animation(path) for path in settings.results]
    result = results[0]
    if settings.is_rest_cage:
        return _write_rest_cage(settings, result, progress)
    animation = Animation(
        rest=result.cage,
        frame_count=len(result.frames),
        scene=settings.scene.override(result.scene),
        name="cage",
        morphs=settings.morphs,
    )
    for each in results:
        report_skipped_frames(each, progress)
    if settings.blender:
        return _write_live_cage(settings, result, animation, progress)
    if settings.skeleton:
        return _write_skeleton(settings, results, animation, progress)
    if settings.with_model:
        return _write_with_model(settings, result, animation, progress)
    blocks = read_cages(result, count_frames(MAX_EXPORT_BYTES, len(result.cage.vertices)))
    return write_converted(settings.output, settings.to, animation, blocks, progress)


def _write_live_cage(
    settings: ExportSettings,
    result: StoredAnimation,
    animation: Animation,
    progress: ProgressListener,
) -> ExportSummary:
    """Write the folder of the model, its cage and the weights for Blender; say how to open it."""
    path = settings.output.path
    target = CagedModel.of_file(result.path, result).read_reconstruction("the model in Blender")
    binding, own = target.binding, len(result.cage.vertices)
    conversion = SceneConversion.of_output(animation.scene, BLENDER_SPACE)
    if conversion:
        progress.note("note", f"{path.name}: {conversion.note}")
    with limit_blas_threads(1), progress.stage("export"):  # the last digits depend on it
        rest = binding.rest.move(binding.rebuilt_rest)
        write_live_cage(
            path,
            settings.output.overwrite,
            replace(animation, rest=rest, name=path.name),
            binding=binding,
            poses=target.cages.poses(count_frames(MAX_EXPORT_BYTES, own)),
            update=progress.update,
        )
    progress.note(
        "note",
        f"{path.name}: in Blender, open {SCRIPT} in the text editor and run it; or install "
        f"{EXTENSION} once, and import by File > Import",
    )
    return ExportSummary(
        path,
        animation.frame_count,
        own + len(rest.vertices),
        sum(file.stat().st_size for file in path.iterdir()),
        _count_both(result),
    )


def _count_both(result: StoredAnimation) -> str:
    """Say how many vertices are of the cage, and how many of the model."""
    cage, model = (group_digits(len(mesh.vertices)) for mesh in (result.cage, result.rest))
    return f"vertices, {cage} of the cage and {model} of the model"


def _check_rest_cage(settings: ExportSettings) -> None:
    """Refuse what the cage at rest alone cannot have, and a file that cannot be written."""
    output, scene = settings.output, settings.scene
    path = output.path
    asked = {
        Hint("with_model", True): settings.with_model,
        Hint("recentre", True): output.recentre,
        Hint("file_format", output.file_format): output.file_format,
        Hint("fps"): scene.fps is not None,
        Hint("start"): scene.start is not None,
        Hint("frame_step"): scene.frame_step is not None,
    }
    given = [hint for hint, is_asked in asked.items() if is_asked]
    if given:
        raise SettingError(
            f"{path}: one `{output.suffix}` file is the cage at rest alone, which takes no "
            + join_texts(" or ", given)
            + f"; leave {'it' if len(given) == 1 else 'them'} out, or write the frames to "
            f"{path.stem}/{path.stem}_####{output.suffix}"
        )
    check_mesh_output(path, output.overwrite)


def _write_rest_cage(
    settings: ExportSettings, result: StoredAnimation, progress: ProgressListener
) -> ExportSummary:
    """Write the cage at rest, which a frame alone would be mistaken for; and note it."""
    path, suffix = settings.output.path, settings.output.suffix
    conversion = SceneConversion.of_output(settings.scene.override(result.scene), settings.to)
    if conversion:
        progress.note("note", f"{path.name}: {conversion.note}")
    vertices = conversion.apply(result.cage.vertices[None])[0]
    write_mesh(path, result.cage, vertices, settings.output.overwrite)
    progress.note(
        "note",
        f"{path.name}: the cage at rest; {path.stem}/{path.stem}_####{suffix} writes all "
        f"{len(result.frames)} frames",
    )
    return ExportSummary(path, 1, len(vertices), path.stat().st_size)


def write_converted(
    output: Output,
    to: SceneHints,
    animation: Animation,
    blocks: Iterator[Floats],
    progress: ProgressListener,
    make_writer: WriterFactory | None = None,
) -> ExportSummary:
    """Write an animation, converted to the unit and the up axis that are asked for."""
    conversion = SceneConversion.of_output(animation.scene, to)
    if conversion:
        progress.note("note", f"{output.path.name}: {conversion.note}")
    return write_animation(
        output,
        conversion.convert_animation(animation),
        map(conversion.apply, blocks),
        progress,
        make_writer,
    )


def _write_skeleton(
    settings: ExportSettings,
    results: Sequence[StoredAnimation],
    animation: Animation,
    progress: ProgressListener,
) -> ExportSummary:
    """Write the rest pose of results, skinned to a joint per cage vertex, with all their motions.

    The animation is that of the first result.
    """
    result, name, jobs = results[0], settings.output.path.name, count_processors()
    layers, influences = _plan_layers(settings, results), settings.influences
    clips: Sequence[Reconstruction] = _read_skeleton(results, settings)
    if influences is None and not isinstance(settings.joints, int):
        fault = _find_fault(clips[0].binding, settings.output.path)
        if fault:
            name, influences = f"{name}: weights are fitted again, as {fault}", DEFAULT_INFLUENCES
    missing = ""
    if not keeps_weights(clips[0].binding, influences, settings.joints):
        clips, missing = find_inputs(results, clips, settings.output.path.name, jobs)
    rig = make_rig(
        result,
        join_clips(clips),
        progress,
        influences=influences,
        name=name,
        joints=settings.joints,
        heads=_count_heads(settings),
        is_shaded=True,
        compares=settings.compares,
        input_rms=measure_rms(results),
        jobs=jobs,
        cache=settings.cache,
    )
    if missing:  # after the error: the first note is read
        progress.note("note", missing)
    named = _describe_clips(settings, results, rig, progress) if len(results) > 1 else ()
    count = sum(len(each.frames) for each in results)
    animation = replace(animation, rest=rig.cage, frame_count=count, clips=named)
    skin, places = rig.stream(turns=settings.joints != "translate")
    conversion = SceneConversion.of_output(animation.scene, settings.to)
    skin = conversion.convert_skin(skin)
    if len(rig.jumps):
        names = _name_joints(conversion.convert_animation(animation), skin)
        frames = [name for each in results for name in each.frames]
        text = _describe_jumps(rig.jumps, names, frames)
        progress.note("warning", f"{settings.output.path.name}: {text}")
    with limit_blas_threads(1):  # the last digits of the cages depend on it
        if layers:
            summary = _write_layers(settings, layers, animation, skin, places, progress)
        else:
            summary = _write_motion(settings, animation, skin, places, progress)
    unit = f"joints that move {group_digits(len(result.rest.vertices))} vertices"
    unit += f", in {len(results)} clips" if named else ""
    return replace(summary, vertex_count=rig.joint_count, unit=unit)


def _write_motion(
    settings: ExportSettings,
    animation: Animation,
    skin: Skin,
    places: Iterator[Floats],
    progress: ProgressListener,
) -> ExportSummary:
    """Write a skin with its motion, or those of several clips, in one file."""
    is_extracted = settings.root_motion == "extract"
    if settings.output.path.suffix.lower() in GltfSkeletonWriter.suffixes:
        make_writer: WriterFactory = partial(
            GltfSkeletonWriter,
            skin=skin,
            is_extracted=is_extracted,
            tolerance=settings.morphs.tolerance,
            is_quantized=settings.quantize,
        )
    else:
        make_writer = partial(
            UsdSkeletonWriter, skin=skin, has_cage=settings.with_model, is_extracted=is_extracted
        )
        animation = replace(animation, guide=animation.name if settings.guide else "")
    return write_converted(settings.output, settings.to, animation, places, progress, make_writer)


def _plan_layers(settings: ExportSettings, results: Sequence[StoredAnimation]) -> list[Output]:
    """Return the file of each clip of several, in a format of one motion per file; else none."""
    output = settings.output
    if len(results) == 1 or output.path.suffix.lower() in GltfSkeletonWriter.suffixes:
        return []
    names = name_part_files(name_clips(results))
    stem, suffix = output.path.stem, output.path.suffix
    layers = [
        replace(output, path=output.path.with_name(f"{stem}_{name}{suffix}")) for name in names
    ]
    check_no_overlap([path for one in layers for path in one.list_paths()], settings.inputs())
    for one in layers:
        one.check_writable()
    return layers


def _write_layers(
    settings: ExportSettings,
    layers: Sequence[Output],
    animation: Animation,
    skin: Skin,
    places: Iterator[Floats],
    progress: ProgressListener,
) -> ExportSummary:
    """Write a skin at rest, and over it a file of each clip, with its motion."""
    is_extracted = settings.root_motion == "extract"
    still = replace(animation, frame_count=0, clips=())
    write_still = partial(UsdSkeletonWriter, skin=skin, is_extracted=is_extracted)
    whole = write_converted(settings.output, settings.to, still, iter(()), progress, write_still)
    conversion = SceneConversion.of_output(animation.scene, settings.to)
    still = conversion.convert_animation(still)
    turns = None if skin.turns is None else iter(skin.turns)  # each clip takes its own
    byte_count, start = whole.byte_count, 0
    counts = [clip.frame_count for clip in animation.clips]
    blocks = cut_blocks(map(conversion.apply, places), counts)
    written = [whole.path.name]
    try:
        for layer, clip, own in zip(layers, animation.clips, blocks, strict=True):
            frames = slice(start, start + clip.frame_count)
            scene = conversion.convert_hints(SceneHints()).override(clip.scene)
            write_motion = partial(
                MotionWriter,
                skin=replace(skin, rotations=skin.rotations[frames], turns=turns, error=clip.error),
                layer=settings.output.path,
                clip=clip.name,
                is_extracted=is_extracted,
            )
            moving = replace(still, frame_count=clip.frame_count, scene=scene)
            summary = write_animation(layer, moving, own, progress, write_motion)
            byte_count, start = byte_count + summary.byte_count, frames.stop
            written.append(layer.path.name)
    except BaseException as error:  # each file is over the first, which has to be there already
        left = [layer.path.name for layer in layers[len(written) - 1 :]]
        add_remark(
            error,
            f"{join_truncated(written)} {'is' if len(written) == 1 else 'are'} written, "
            f"{join_truncated(left)} not; " + say("write all again with `overwrite=True`"),
        )
        raise
    progress.note(
        "note",
        f"{whole.path.name}: the mesh and its skeleton at rest; over it, a file of each clip: "
        + join_truncated(layer.path.name for layer in layers),
    )
    return replace(whole, byte_count=byte_count, frame_count=sum(counts))


def _describe_clips(
    settings: ExportSettings,
    results: Sequence[StoredAnimation],
    rig: Rig,
    progress: ProgressListener,
) -> tuple[NamedClip, ...]:
    """Return the clips of several results, and note the errors that the rig has in each."""
    clips, start = [], 0
    for name, result in zip(name_clips(results), results, strict=True):
        stop = start + len(result.frames)
        error, text = rig.describe_clip(slice(start, stop), measure_input_rms(result))
        scene = settings.scene.override(result.scene)
        clips.append(NamedClip(name, len(result.frames), scene, error))
        frames = f"{format_count(len(result.frames), 'frame')}, {scene.fps:g} fps"
        progress.note("clip", f"{name}: {frames}; {text}")
        start = stop
    return tuple(clips)


def _name_joints(animation: Animation, skin: Skin) -> list[str]:
    """Return the names that a file gives to the joints that move the mesh."""
    skeleton = Skeleton(animation.rest.vertices, skin, up_axis=animation.scene.up_axis)
    return skeleton.names[skeleton.lead :]


def _describe_jumps(jumps: Integers, names: Sequence[str], frames: Sequence[str]) -> str:
    """Return a sentence on the joints that jump in some frames, (k, 2); `names` are of all."""
    joints = np.unique(jumps[:, 1])
    found = (
        f"{names[joint]} ({join_truncated(frames[f] for f in jumps[jumps[:, 1] == joint, 0])})"
        for joint in joints
    )
    many = len(joints) > 1
    return (
        f"{format_count(len(joints), 'joint')} turn{'' if many else 's'} by more than "
        f"{MIN_TURN:g} degrees in one frame where the surface does not: {join_truncated(found)}; "
        "programs that show frames between these may turn the surface there"
    )


def _write_with_model(
    settings: ExportSettings,
    result: StoredAnimation,
    animation: Animation,
    progress: ProgressListener,
) -> ExportSummary:
    """Write the cages, and beside them the model that they move."""
    target = CagedModel.of_file(result.path, result).read_reconstruction("the model")
    parts = split_parts(result.rest)
    names = nest_names([part.name or "model" for part in parts], animation.name)
    cage = f"{name_root(names, animation.name)}/{animation.name}"
    meshes = [result.cage, *(part.mesh for part in parts)]
    transforms = [np.eye(4), *(part.transform for part in parts)]
    animation = replace(
        animation,
        rest=join_meshes(meshes, [cage, *names], transforms),
        guide=cage if settings.guide else "",
    )
    outputs = split_output(settings.output, animation.rest, animation.name)
    check_no_overlap([path for one in outputs for path in one.list_paths()], settings.inputs())
    for one in outputs:
        one.check_writable()
    size = count_frames(MAX_EXPORT_BYTES, len(result.cage.vertices) + len(result.rest.vertices), 4)
    frames = (np.concatenate([block.cages, block.meshes], axis=1) for block in target.blocks(size))
    with limit_blas_threads(1):  # the last digits of the model depend on it
        summary = write_converted(settings.output, settings.to, animation, frames, progress)
    return replace(summary, unit=_count_both(result))


def _read_skeleton(
    results: Sequence[StoredAnimation], settings: ExportSettings
) -> list[Reconstruction]:
    """Read what a skin is to follow; refuse what cannot be skinned."""
    result = results[0]
    check_rig(result, settings.influences, settings.joints, _count_heads(settings))
    return read_clips(results, "a skeleton")


def _count_heads(settings: ExportSettings) -> int:
    """Return how many joints are above the limbs: the root, and the body."""
    return 2 if settings.root_motion == "extract" else 1


def _find_fault(binding: Binding, path: Path) -> str:
    """Return why weights cannot be written as they are; empty if they can."""
    cut = -np.minimum(binding.weights, 0).sum(axis=1).min()
    if cut > MAX_CUT_WEIGHT:
        return f"those of the result are negative in places (down to {binding.weights.min():.2g})"
    count = count_influences(binding)
    if path.suffix.lower() in GltfSkeletonWriter.suffixes and count > MAX_INFLUENCES:
        return f"up to {count} joints move a vertex, of which programs read {MAX_INFLUENCES}"
    return ""


def check_export(settings: ExportSettings) -> None:
    """Refuse, before any work, an export that is impossible."""
    path = settings.output.path
    suffix = path.suffix.lower()
    skeleton_suffixes = (*UsdSkeletonWriter.suffixes, *GltfSkeletonWriter.suffixes)
    if settings.skeleton and suffix not in skeleton_suffixes:
        raise SettingError(
            f"{path}: "
            + say("`skeleton=True` works with USD and glTF only, expected ")
            + f"{', '.join(skeleton_suffixes)}"
        )
    for name, value, known in (
        ("joints", settings.joints, JOINT_MOTIONS),
        ("root_motion", settings.root_motion, ROOT_MOTIONS),
    ):
        if isinstance(value, str) and value not in known:
            raise SettingError(Hint(name, value) + f", expected {' or '.join(known)}")
    _check_results(settings)
    if settings.blender:
        _check_live_cage(settings)
        return
    if settings.is_rest_cage:
        _check_rest_cage(settings)
        return
    _check_skeleton(settings)
    if settings.guide and suffix not in UsdWriter.suffixes:
        raise SettingError(
            f"{path}: "
            + say("`guide=True` works with USD only, expected ")
            + f"{', '.join(UsdWriter.suffixes)}"
        )
    has_parts = names_parts(path)
    if has_parts and (settings.skeleton or not settings.with_model):
        what = "a skeleton" if settings.skeleton else "a cage"
        raise SettingError(
            f"{path}: {what} has no parts; leave {PLACEHOLDER} out of the name, or write the parts "
            "of the model by cageik deform"
        )
    if settings.with_model:
        _check_with_model(settings)
    if not has_parts:
        settings.output.check_writable()


def _check_live_cage(settings: ExportSettings) -> None:
    """Refuse what the folder for Blender cannot have, and a folder that cannot be written."""
    output = settings.output
    given = [
        hint
        for hint, is_asked in {
            Hint("file_format", output.file_format): output.file_format,
            Hint("recentre", True): output.recentre,
            Hint("to"): settings.to != SceneHints(),
        }.items()
        if is_asked
    ]
    if given:
        raise SettingError(
            f"{output.path}: is for Blender, which has metres and z up, and a place for each "
            "object; leave out " + join_texts(" and ", given)
        )
    if not output.is_folder:
        raise SettingError(
            f"{output.path}: "
            + say("`blender=True` writes a folder, expected a name without a suffix, such as ")
            + (output.path.stem or "hero")
        )
    check_live_cage_writable(output.path, output.overwrite)


def _check_results(settings: ExportSettings) -> None:
    """Refuse several results of what holds one, and one that is named twice."""
    path, count = settings.output.path, len(settings.results)
    if count > 1 and not settings.skeleton:
        raise SettingError(
            f"{path}: holds the cages of one result (found {count}); export them one by one, or as "
            "animations of one skeleton by " + Hint("skeleton", True)
        )
    if count > 1 and settings.with_model:
        raise SettingError(
            f"{path}: the skeleton of several results is without the cage; "
            + say("leave out `with_model=True`")
        )
    if count > 1 and path.suffix.lower() == ".usdz":
        raise SettingError(
            f"{path}: a `.usdz` is one file, and each of {count} clips is a file over that of the "
            "skeleton; write .usdc, or .glb, which holds them all"
        )
    places = [result.resolve() for result in settings.results]
    for result, place in zip(settings.results, places, strict=True):
        if places.count(place) > 1:
            raise SettingError(f"{result}: is named twice; name each result once")


def _check_skeleton(settings: ExportSettings) -> None:
    """Refuse what a skeleton, or its format, cannot have."""
    path = settings.output.path
    is_gltf = path.suffix.lower() in GltfSkeletonWriter.suffixes
    if is_gltf and settings.influences is not None and settings.influences > MAX_INFLUENCES:
        raise SettingError(
            f"{path}: "
            + Hint("influences", settings.influences)
            + f", and programs read at most {MAX_INFLUENCES} joints per vertex from .glb; give "
            f"4, or {MAX_INFLUENCES}"
        )
    only_gltf = {
        Hint("tolerance"): settings.skeleton and settings.morphs.tolerance is not None,
        Hint("quantize", True): settings.quantize,
    }
    for hint, is_asked in only_gltf.items():
        if is_asked and not (settings.skeleton and is_gltf):
            raise SettingError(
                f"{path}: " + hint + " of a skeleton works with glTF only, expected .glb"
            )
    if settings.with_model and isinstance(settings.joints, int):
        raise SettingError(
            f"{path}: "
            + Hint("joints", settings.joints)
            + say(" are not the vertices of the cage; leave out `with_model=True`, or `joints=`")
        )


def _check_with_model(settings: ExportSettings) -> None:
    """Refuse a format that cannot hold a cage and its model."""
    path = settings.output.path
    if not (settings.output.find_writer().keeps_parts or names_parts(path)):
        raise SettingError(
            f"{path}: "
            + say(
                "`with_model=True` works with formats of several meshes, expected .usdc, "
                ".abc, .glb or .obj, or a file of each by "
            )
            + f"{PLACEHOLDER} in the name"
        )
    if settings.skeleton and path.suffix.lower() in GltfSkeletonWriter.suffixes:
        raise SettingError(
            f"{path}: a skeleton in glTF is the model alone, without the cage; "
            + say("leave out `with_model=True`, or write .usdc, which holds both")
        )
