"""The page that answers: it plays clips, poses models and edits cages, on this machine only.

Depends on `run` and `report`. Start with `run`; `server` answers the page, and `player` holds the
data that its scripts draw.
"""
