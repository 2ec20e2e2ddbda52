"""The parts of the cage builder: shell, decimation, push, tested edits, judge.

Depends on `geometry` and on `cages.check`. Lengths in here are in diagonals of the model,
which `Demand` has scaled and moved to the origin. Start with `build`.
"""
