"""The handles file: which points of a surface move where, in which frames of a clip.

Depends on `geometry` and the anchors of `method.pose`. Start with `model`, the records, and
`reader`, from JSON to them; `placement` finds the point of each handle, and `schedule` says when it
acts.
"""
