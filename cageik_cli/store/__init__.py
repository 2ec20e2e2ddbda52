"""What is kept on disk: results, bindings, checkpoints of runs, the cache of weights.

Depends on `solver` and `coordinates`. Start with `result`, what a finished run leaves, and
`checkpoint`, what an interrupted one does.
"""
