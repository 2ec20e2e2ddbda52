"""One module per command: settings in, result out; no parsing of words and no printing.

Depends on every folder below. Start with `extract`, the main job: open, bind, factor, solve
block by block, write. `batch` does it for every clip under some folders. `api` has the functions of
the Python API.
"""
