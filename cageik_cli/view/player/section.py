"""The player of a page: its data for the script as one text, its section, and a page of it alone.

Large models are drawn coarser. The bar of time shows, as paths of an SVG, how far off each frame
is.
"""

import json
import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.mirror import find_mirror
from cageik_cli.geometry.parts import get_parts
from cageik_cli.geometry.surface_distance import SurfaceDistances
from cageik_cli.method.pose.constraints import MAX_ASYMMETRY
from cageik_cli.method.pose.settings import DEFAULT_POSE_ALPHA
from cageik_cli.method.weights.binding import Binding
from cageik_cli.report.html.templating import PlayerPart, Templates
from cageik_cli.report.regions import measure_rms
from cageik_cli.report.render.shading import (
    COLOUR_SCALE,
    MESH_COLOURS,
    SIGNED_SCALE,
    choose_scale_end,
)
from cageik_cli.report.vocabulary import EXTRACTION_VOCABULARY, VOCABULARIES, Vocabulary
from cageik_cli.store.result import StoredAnimation
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import FormatError
from cageik_cli.util.text import format_count, group_digits
from cageik_cli.view.player.clip import (
    PlayerClip,
    find_base_colours,
    find_ground,
    load_player_clip,
    make_single_pose,
    require_player_clip,
)
from cageik_cli.view.player.compression import (
    SMALL_MAX_LEVEL,
    Predictor,
    decimate,
    find_smooth_motions,
    pack_arrays,
    round_weights,
)
from cageik_cli.view.player.scripts import PLAYER_SCRIPTS, read_scripts

MAX_DRAWN_VERTICES = 50_000
"""A larger model is decimated."""

MAX_WEIGHTS = 1 << 24
"""Weights of a page at most; a model of more in its cage is decimated, too."""

MAX_INT16 = 32_767
"""The largest integer that steps of lengths are stored as."""

MIN_ERROR_STEP = 1e-5
"""Smallest step of stored errors, in diagonals: smaller errors are not seen."""

VIEW_TEMPLATES = Templates("cageik_cli.view", "cageik_cli.report.html")

MODES = {"look": "Look", "pose": "Pose", "cage": "Cage", "influence": "Influence"}
"""What pointers on the picture can do: names of modes, and of their buttons."""

BEFORE_WORDS = {"input": "input", "unedited": "before the edit", "live": "without my edits"}
"""What the mesh that is shown can be compared with."""

PANELS = ("pose", "cage", "influence", "save", "look", "parts")
"""Groups of the side panel, from top to bottom: names of templates."""

SERVED_SCRIPTS = ("apply", "frames")
"""Scripts that are added for a page with a server: only these send anything."""

REST_SCRIPTS = ("cage_mesh", "rest_mode", "apply", "session")
"""Scripts that are added for the page of a rest cage."""

POSE_SCRIPTS = (
    "hold",
    "edit_meter",
    "response",
    "poser",
    "tracks",
    "document",
    "editor",
    "handles",
    "cage_edits",
    "cage_mode",
    "influence",
)
"""Scripts that it does not need."""

REST_MODES = {"look": "Look", "rest": "Rest cage"}
"""What pointers on the picture of that page can do."""

REST_PANELS = ("rest", "save", "look", "parts")
"""Groups of the side panel of that page."""


def build_player(clip: PlayerClip, words: Vocabulary = EXTRACTION_VOCABULARY) -> PlayerPart:
    """Build the player that the page of a report is handed."""
    return render_player(build_player_values(clip), PLAYER_SCRIPTS, words)


def render_player(
    values: dict[str, Any], scripts: tuple[str, ...], words: Vocabulary = EXTRACTION_VOCABULARY
) -> PlayerPart:
    """Render the section of a player from its values, with scripts by their names."""
    return PlayerPart(
        VIEW_TEMPLATES.render("player.html.j2", player=values, words=words),
        VIEW_TEMPLATES.read("player.css"),
        read_scripts(scripts),
    )


def load_player(result: StoredAnimation) -> PlayerPart | None:
    """Read what the page of a report is handed of a player; None of a result without weights."""
    clip = load_player_clip(result)
    return None if clip is None else build_player(clip, VOCABULARIES[result.FORMAT])


def build_player_values(clip: PlayerClip, apply_url: str = "") -> dict[str, Any]:
    """Collect the values of the section; `apply_url` is as in `build_payload`."""
    rest, notes = clip.binding.rest, []
    count, drawn = len(rest.vertices), len(choose_vertices(rest, clip.binding.cage)[0])
    if drawn < count:
        notes.append(
            f"The player draws {drawn} of {format_count(count, 'vertex')}, so that the page stays "
            "small; figures and pictures are of all."
        )
    if clip.left_out:
        notes.append(
            f"The player shows the first {format_count(len(clip.frames), 'frame')}; the last "
            f"{clip.left_out} are left out, so that the page stays small."
        )
    return {
        "title": "Player" if clip.frames else "Pose",
        "payload": build_payload(clip, apply_url),
        "panels": PANELS,
        "modes": MODES,
        "mode": "look" if clip.frames else "pose",
        "is_app": False,
        "is_served": False,
        "is_again": False,
        "timeline": build_timeline(clip),
        "has": list_features(clip),
        "before": {kind: BEFORE_WORDS[kind] for kind in list_before_kinds(clip)},
        "parts": _list_parts(clip),
        "notes": notes,
    }


def list_features(clip: PlayerClip) -> set[str]:
    """List what the clip has of what some controls need; those without it are hidden."""
    has = {
        "frames": clip.frames,
        "inputs": clip.held,
        "errors": clip.vertex_rms is not None,
        "colours": find_base_colours(clip.binding.rest) is not None,
        "region": clip.focus,
        "mirror": find_mirror(clip.binding.cage.vertices, MAX_ASYMMETRY),
    }
    return {name for name, value in has.items() if value}


def list_before_kinds(clip: PlayerClip) -> list[str]:
    """List what the mesh of a clip can be compared with, that which is held first."""
    held = [clip.original] if clip.held else []
    return list(dict.fromkeys([*held, *clip.before, "live"]))


def render_view_page(
    clip: PlayerClip,
    apply_url: str = "",
    *,
    handles: str = "",
    cage_edits: str = "",
    words: Vocabulary = EXTRACTION_VOCABULARY,
    session: dict[str, Any] | None = None,
) -> str:
    """Render a page that plays a clip and poses its model; the same text for the same arguments.

    Parameters
    ----------
    apply_url : str
        Where the page sends edits when they are applied, relative to its own address; "" if they
        are only saved, and the page sends nothing at all.
    handles, cage_edits : str
        The texts of such files that the page begins with, which have to be JSON; "" for none.
    words : Vocabulary
        Those for the kind of clip.
    session : dict, optional
        What a page that is served has to know, see `PageSession.describe`.
    """
    *scripts, start = PLAYER_SCRIPTS
    added = SERVED_SCRIPTS if session is None else (*SERVED_SCRIPTS, "session")
    values = build_player_values(clip, apply_url)
    values |= {"is_app": True, "title": clip.title or "Model in its cage"}
    values |= {"is_served": session is not None}
    return VIEW_TEMPLATES.render_page(
        "view.html.j2",
        player=render_player(values, (*scripts, *added, start), words),
        title=clip.title,
        is_connected=session is not None or bool(apply_url or clip.before),
        handles=_embed(handles),
        cage_edits=_embed(cage_edits),
        session=_embed(json.dumps(session) if session else ""),
    )


def _embed(text: str) -> str:
    """Return JSON that cannot end the element that holds it: in it, "<" is only in strings."""
    return text.replace("<", "\\u003c")


def render_player_page(result: StoredAnimation) -> str:
    """Render a small page that plays a result and poses it: a file to send.

    It has no input of any frame, and its weights are rounded to `SMALL_MAX_LEVEL`.

    Raises
    ------
    SettingError
        When the result was written without weights.
    """
    clip = require_player_clip(result, "a player")
    return render_view_page(
        replace(clip, held={}, max_level=SMALL_MAX_LEVEL), words=VOCABULARIES[result.FORMAT]
    )


def render_rest_cage_page(
    clip: PlayerClip, apply_url: str, cage: str, session: dict[str, Any]
) -> str:
    """Render the page of a model whose rest cage is edited.

    Parameters
    ----------
    clip : PlayerClip
        The model, at rest.
    apply_url : str
        Where the page sends the cage that is to be written; "" if it cannot be.
    cage : str
        The JSON of the cage to begin with.
    session : dict
        As of `render_view_page`, and under `again` what is known of an extraction, if it is the
        cage of a result.
    """
    *scripts, start = (name for name in PLAYER_SCRIPTS if name not in POSE_SCRIPTS)
    values = build_player_values(clip, apply_url)
    values |= {"is_app": True, "title": clip.title, "mode": "rest"}
    values |= {"panels": REST_PANELS, "modes": REST_MODES, "is_served": True, "before": {}}
    values |= {"is_again": "again" in session}
    return VIEW_TEMPLATES.render_page(
        "view.html.j2",
        player=render_player(values, (*scripts, *REST_SCRIPTS, start)),
        title=clip.title,
        is_connected=True,  # checks and weights are asked for
        handles="",
        cage_edits="",
        rest_cage=_embed(cage),
        session=_embed(json.dumps(session)),
    )


def build_payload(clip: PlayerClip, apply_url: str = "") -> str:
    """Build the data of a player.

    Lengths are in diagonals of the rest model, and positions relative to the middle of its cage, so
    that single precision is enough anywhere. The page sends its handles to `apply_url` when they
    are applied; if it is "", they are only saved. The text is as of `pack_arrays`.
    """
    rest, cage = clip.binding.rest, clip.binding.cage
    diagonal, origin = rest.diagonal or 1.0, cage.vertices.mean(axis=0)
    chosen, faces = choose_vertices(rest, cage)
    mirror = find_mirror(clip.binding.cage.vertices, MAX_ASYMMETRY)
    skin, arrays = pack_skin(clip, chosen, faces, origin)
    step = 2.0**-20  # of cages: a power of two, so that the last bits of numbers are zero
    arrays |= {
        "cageFaces": cage.faces.astype("<u4"),
        # By coordinate: neighbouring numbers are then alike, and pack better.
        "cages": _scale(np.rint((clip.cages - origin) / diagonal / step) * step).T,
        # Positions are relative to the origin, and turning about it moves nothing else.
        "rotations": clip.rotations.astype("<f4"),
    }
    header = {
        "schema": 1,
        "origin": origin.tolist(),
        "diagonal": diagonal,
        **skin,
        "vertexCount": len(rest.vertices),
        "isClip": bool(clip.frames),
        "frames": list(clip.frames),
        "start": clip.timeline.start if clip.timeline else 0.0,
        "step": clip.timeline.step if clip.timeline else 1.0,
        "skipped": list(clip.skipped),
        "frameRms": list_frame_errors(clip),
        "fps": clip.fps,
        "up": clip.up_axis,
        "ground": (find_ground(clip) - origin["XYZ".index(clip.up_axis)]) / diagonal,
        "parts": _list_parts(clip),
        "focus": _list_focus(clip, chosen),
        "mirror": mirror and mirror.to_record(),
        "colours": list(COLOUR_SCALE),
        "signedColours": list(SIGNED_SCALE),
        "missing": MESH_COLOURS["missing"],
        "alpha": DEFAULT_POSE_ALPHA,
        "rigidity": 0,  # rounds that the page offers first: limbs that are held swing without them
        "target": clip.target,
        "applyUrl": apply_url,
        "original": clip.original,
        "before": list(clip.before),
    }
    arrays |= _mark_polygons("joinedCageFaces", cage)
    if len(chosen) == len(rest.vertices):
        arrays |= _mark_polygons("joinedFaces", rest)
    if (tints := find_base_colours(rest)) is not None:
        arrays["tints"] = tints[chosen]
    if len(faces):
        links = SurfaceDistances(TriMesh(rest.vertices[chosen], faces)).links
        if len(links):
            arrays["links"] = links.astype("<u4")
    if len(chosen) < len(rest.vertices):
        arrays["vertices"] = chosen.astype("<u4")
    header |= _add_errors(clip, chosen, arrays)
    # These are smooth over the surface, and stored as differences from a prediction.
    header["predicted"] = [name for name in ("weights", "held") if name in arrays]
    predictor = Predictor(faces, len(chosen))
    for name in header["predicted"]:
        arrays[name] = predictor.encode(arrays[name])
    return pack_arrays(header, arrays)


def pack_skin(
    clip: PlayerClip, chosen: Integers, faces: Integers, origin: Floats
) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return what the script makes a `Skin` of: values of the header, and arrays.

    `chosen` and `faces` are as of `choose_vertices`.
    """
    binding = clip.binding
    diagonal = binding.rest.diagonal or 1.0
    cage = (binding.cage.vertices - origin) / diagonal
    smooth = find_smooth_motions(binding.cage)
    rounded = round_weights(binding.weights[chosen], smooth, clip.max_level)
    arrays: dict[str, NDArray[Any]] = {
        "faces": faces.astype("<u4"),
        # By column, so that neighbouring numbers are alike.
        "weights": np.ascontiguousarray(rounded.integers.T).astype("<i2"),
        "smooth": np.ascontiguousarray(rounded.motions.T).astype("<f4"),
        "rests": np.ascontiguousarray(rounded.rests.T),
        "cage": _scale(cage),
    }
    # What the weights of the page lack to the base mesh: little, unless they have offsets.
    lack = (clip.base[chosen] - origin) / diagonal - rounded.restore() @ cage
    min_step = 1e-7  # diagonals, as single precision has
    step = max(float(np.abs(lack).max()) / MAX_INT16, min_step)
    arrays["lack"] = np.ascontiguousarray(np.rint(lack / step).T).astype("<i2")
    steps = {"levels": rounded.levels, "restStep": rounded.rest_step, "lackStep": step}
    return steps, arrays


def choose_vertices(rest: TriMesh, cage: TriMesh | None = None) -> tuple[Integers, Integers]:
    """Choose the vertices that are drawn, and faces between them: all, unless there are too many.

    They are returned as by `decimate`. With a cage, the weights in it count as well.
    """
    count, largest = len(rest.vertices), MAX_DRAWN_VERTICES
    if cage is not None:
        largest = min(largest, MAX_WEIGHTS // len(cage.vertices))
    return (np.arange(count), rest.faces) if count <= largest else decimate(rest, largest)


def check_drawn_weights(rest: TriMesh, cage: TriMesh) -> None:
    """Refuse a cage whose weights would be too many for the page."""
    most = 2 * MAX_WEIGHTS // min(len(rest.vertices), MAX_DRAWN_VERTICES)
    if len(cage.vertices) > most:
        raise FormatError(
            f"the weights of {group_digits(len(cage.vertices))} cage vertices are too many for "
            "the page, at most "
            f"{most} for this model; save the cage, and use cageik view without editing it"
        )


def pack_weights(binding: Binding, origin: Floats) -> str:
    """Pack the weights of a cage for the page; `origin` is that of its positions."""
    chosen, faces = choose_vertices(binding.rest)
    header, arrays = pack_skin(make_single_pose(binding), chosen, faces, origin)
    predictor = Predictor(faces, len(chosen))
    arrays["weights"] = predictor.encode(arrays["weights"])
    return pack_arrays({**header, "predicted": ["weights"]}, arrays)


def _mark_polygons(name: str, mesh: TriMesh) -> dict[str, NDArray[Any]]:
    """Return which triangles go on with the polygon of the one before; nothing if none does."""
    is_joined = np.diff(mesh.polygons.triangle_polygons, prepend=-1) == 0
    return {name: is_joined.astype("i1")} if is_joined.any() else {}


def _scale(values: Floats, largest: float = 1e30) -> NDArray[np.float32]:
    """Draw what is farther away at `largest`, in diagonals: single precision ends near."""
    return np.clip(values, -largest, largest).astype("<f4")


def _add_errors(
    clip: PlayerClip, chosen: Integers, arrays: dict[str, NDArray[Any]]
) -> dict[str, Any]:
    """Add the errors over the clip and of held frames to the arrays; return their scales."""
    missing_level, min_step = 0xFFFF, MIN_ERROR_STEP
    scales: dict[str, Any] = {"held": [], "rms": None}
    if clip.vertex_rms is not None:
        rms = clip.vertex_rms[chosen]
        is_known = np.isfinite(rms)
        top = float(rms[is_known].max(initial=0.0)) or 1.0
        levels = np.full(len(rms), missing_level, "<u2")
        levels[is_known] = np.rint(rms[is_known] / top * (missing_level - 1))
        arrays["rms"] = levels
        scales["rms"] = {"top": top, "end": choose_scale_end(rms[is_known])}
    if clip.held:
        # Vertices that are missing in a frame have no error there.
        errors = np.nan_to_num(np.stack([errors[chosen] for _, errors in clip.held.values()]))
        step = max(float(np.abs(errors).max()) / MAX_INT16, min_step)
        # By coordinate, for the same reason as weights by column.
        arrays["held"] = np.rint(errors / step).transpose(0, 2, 1).astype("<i2")
        scales["held"] = [
            {"frame": frame, "label": label} for frame, (label, _) in clip.held.items()
        ]
        scales["heldStep"] = step
        all_errors = np.concatenate([errors for _, errors in clip.held.values()])
        deviations = 100 * np.linalg.norm(all_errors, axis=1)
        scales["deviationEnd"] = choose_scale_end(deviations[np.isfinite(deviations)])
    return scales


def _list_parts(clip: PlayerClip) -> list[dict[str, Any]]:
    """List the parts of the model with their errors, percent; nothing for a model of one part."""
    parts = get_parts(clip.binding.rest)
    if parts is None:
        return []
    errors = clip.vertex_rms
    return [
        {
            "name": name,
            "vertices": vertices.stop - vertices.start,
            "rms": None if errors is None else measure_rms(errors[vertices]),
        }
        for name, vertices in zip(parts.names, parts.vertex_slices, strict=True)
    ]


def _list_focus(clip: PlayerClip, chosen: Integers) -> dict[str, Any] | None:
    """List where the worst region is; its vertex is the nearest of those that are drawn."""
    if clip.focus is None:
        return None
    rest = clip.binding.rest.vertices
    nearest = np.linalg.norm(rest[chosen] - rest[clip.focus["vertex"]], axis=1).argmin()
    return clip.focus | {"vertex": int(nearest)}


MAX_TIMELINE_COLUMNS = 600
"""More frames share columns: the bar has about so many pixels."""

MIN_COLUMN_HEIGHT = 0.04
"""Share of the bar that a frame without error takes, so that it is seen to be there."""


def list_frame_errors(clip: PlayerClip) -> list[float | None] | None:
    """List the errors of the frames, percent; None for a frame that was skipped."""
    if clip.frame_rms is None:
        return None
    digits = 6  # more than the bar of time can show
    errors = clip.frame_rms.tolist()
    return [round(one, digits) if math.isfinite(one) else None for one in errors]


def build_timeline(clip: PlayerClip) -> dict[str, Any]:
    """Build the values of the bar of time.

    Returns
    -------
    dict
        `last`, the number of the last frame from 0, which is the width of `paths`; these, by the
        class of what they show: columns as high as the errors of their frames, and full ones
        where all frames were skipped; and `ticks`, pairs of what a frame is, such as "worst", and
        where, percent of the width; and `jumps`, pairs of a frame from 0 and what it is.
    """
    last = max(len(clip.frames) - 1, 0)
    return {
        "last": last,
        "paths": {} if clip.frame_rms is None or not last else draw_columns(clip.frame_rms),
        "ticks": [
            (label, 100 * frame / last) for frame, (label, _) in clip.held.items() if last > 0
        ],
        "jumps": [(frame, label) for frame, (label, _) in clip.held.items()],
    }


def draw_columns(errors: Floats) -> dict[str, str]:
    """Draw columns of errors, nan where a frame was skipped, in a bar of the height 1."""
    last = len(errors) - 1
    columns = min(len(errors), MAX_TIMELINE_COLUMNS)
    edges = np.arange(columns + 1) * len(errors) // columns
    top = float(errors[np.isfinite(errors)].max(initial=0.0)) or 1.0
    paths = {"error": "", "skipped": ""}
    for start, stop in pairwise(edges):
        known = errors[start:stop][np.isfinite(errors[start:stop])]
        height = max(MIN_COLUMN_HEIGHT, known.max() / top) if len(known) else 1.0
        left, right = max(start - 0.5, 0), min(stop - 0.5, last)
        paths["error" if len(known) else "skipped"] += f"M{left:g} 1V{1 - height:.4g}H{right:g}V1z"
    return paths
