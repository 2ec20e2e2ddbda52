"""Let the site show the project's pictures and examples without a second copy of them.

Pages link to `../data_fixtures/...`, as they must to work in the repository. The site holds those
files under `data_fixtures/`.
"""

from pathlib import Path

from mkdocs.structure.files import File

_SHARED = (
    "data_fixtures/pictures/*.png",
    "data_fixtures/pictures/*.webp",
    "data_fixtures/walker/*.json",
)


def on_files(files, config):
    """Add the shared files to the site."""
    root = Path(config.config_file_path).parent
    for pattern in _SHARED:
        for path in sorted(root.glob(pattern)):
            place = path.relative_to(root).as_posix()
            files.append(File.generated(config, place, abs_src_path=str(path)))
    return files


def on_page_markdown(markdown, **_):
    """Point links at the places of the shared files in the site."""
    return markdown.replace("](../data_fixtures/", "](data_fixtures/")
