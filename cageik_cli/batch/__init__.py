"""Many clips: found under folders, extracted by processes of this machine or of a cluster.

Depends on `run`. Start with `run`; `discover` finds the clips, `jobs` is what one process does.
"""
