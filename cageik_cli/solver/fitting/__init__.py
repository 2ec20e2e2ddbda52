"""Weights fitted to clips: a least-squares problem over the weights alternates with the cage solve.

Depends on `coordinates` and on the rest of `solver`. `record` has the settings and what comes out;
start with `fit`, which goes from clips to a fitted binding and a report. `sample` chooses frames,
`alternate` takes the rounds, `problem` fits weights to given cages, `influences` few of them.
"""
