"""One module per command: settings in, result out; it parses no options and prints nothing.

Depends on every folder below. Start with `plan` and `extract`, the main job: open, bind, factor,
solve block by block, write. `batch` runs it for every clip under some folders. `api` has the
functions of the Python API.
"""
