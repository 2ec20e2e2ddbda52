"""Animations out: every writer takes the same blocks of frames."""

from cageik_cli.export.animation import Animation, AnimationWriter
from cageik_cli.export.opening import created, prepare_animation

__all__ = ["Animation", "AnimationWriter", "created", "prepare_animation"]
