"""Our HDF5 files: results, bindings, and the cache of weights."""
