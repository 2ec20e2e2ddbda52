"""One module per command, without click: settings in, result out; nothing is printed.

Depends on every folder below. Start with `extraction`, the main job: open, bind, factor, solve
block by block, write. `api` has the functions of the Python API.
"""
