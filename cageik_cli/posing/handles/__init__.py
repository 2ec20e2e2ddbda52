"""The handles file: which points of a surface go where, in which frames of a clip.

Depends on `geometry` and the anchors of `posing`. Start with `model`, the records, and `reader`,
from JSON to them; `placement` finds each handle's point, and `schedule` when it acts.
"""
