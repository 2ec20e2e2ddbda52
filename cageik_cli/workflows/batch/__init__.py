"""Every clip under some folders, in processes of this machine or on a Dask cluster.

Depends on the other workflows and on `report`. Start with `run`; `discover` finds the clips, and
`jobs` has the work on one of them.
"""
