"""Edits of a result: files of handles and of cage edits, and what they do to an animation.

Depends on `method.pose` and `formats`. Start with `edits`; `handles` reads handles files,
`cage_edits` those of cage edits.
"""
