"""What every other folder may use: errors, progress, text, threads, safe outputs, array types.

Depends on nothing in the package. Start with `errors`: each failure a user sees is one of its
classes.
"""
