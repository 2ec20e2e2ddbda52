"""A model that its cage moves live in Blender: a folder with the data, a script and an extension.

`templates` has what runs in Blender. It reads plain arrays, and imports nothing of this package.
"""
