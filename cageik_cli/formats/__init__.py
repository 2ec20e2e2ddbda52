"""Animations in and out: a module or a folder per format, with its `Reader`, its `Writer` or both.

Depends on `geometry` and `util`. Start with `open`, from what a user typed to a clip, and `write`,
from blocks of frames to a file. `settings` says how a clip is read, `timeline` what its frames are
called; `base` holds what formats share. A new format is one new module here.
"""
