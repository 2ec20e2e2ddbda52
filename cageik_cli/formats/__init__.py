"""Animations in and out: one module per file format, with its `Reader`, its `Writer` or both.

Depends on `geometry`. Start with `open`, from what a user typed to a clip, and `write`, from blocks
of frames to a file; `base` holds what formats share. A new format is one new module here.
"""
