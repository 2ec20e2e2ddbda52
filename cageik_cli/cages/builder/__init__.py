"""The parts of the cage builder: shell, decimation, push, tested edits, judge.

Depends on `geometry` and on the checks beside it. Lengths in here are in diagonals of the model,
which `Demand` has scaled and moved to the origin. Start with `cages/builder/build.py`.
"""
