"""Animations out: every writer takes the same blocks of frames."""

from cageik_cli.export.animation import Animation, AnimationWriter
from cageik_cli.export.opening import created, prepare_animation
from cageik_cli.export.writing import Output, Written, write_animation

__all__ = [
    "Animation",
    "AnimationWriter",
    "Output",
    "Written",
    "created",
    "prepare_animation",
    "write_animation",
]
