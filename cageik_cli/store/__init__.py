"""Files of cageik's own: results, edits, bindings, checkpoints of runs, the weight cache.

Depends on `method` and `fit`. Start with `result`, which a finished run writes, and
`checkpoint`, which an interrupted run leaves.
"""
