"""From the name of an output to its writer."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

from cageik_cli.errors import InputError, located
from cageik_cli.export import writers
from cageik_cli.export.animation import Animation, AnimationWriter
from cageik_cli.outputs import prepare, whole_path


def prepare_animation(path: Path, overwrite: bool) -> None:
    """Refuse, before any work, an output of no known kind, that exists or cannot be written.

    Raises
    ------
    InputError
        Naming the output and what to do.
    """
    _writer_of(path)
    prepare(path, overwrite)


@contextmanager
def created(path: Path, animation: Animation, overwrite: bool) -> Iterator[AnimationWriter]:
    """A writer of the kind of `path`, which gets its name when the block ends without an error.

    Raises
    ------
    InputError
        When it cannot be written, or cannot hold the animation.
    """
    kind = _writer_of(path)
    with whole_path(path, overwrite) as target:
        with located(path):
            writer = kind(target, animation)
        try:
            yield writer
            writer.complete()
        except BaseException:
            writer.abandon()
            raise


def _writer_of(path: Path) -> type[AnimationWriter]:
    by_suffix = _writers()
    if path.suffix.lower() not in by_suffix:
        raise InputError(
            f"{path}: `{path.suffix}` is not a kind of animation written here, expected "
            f"{', '.join(by_suffix)}"
        )
    return by_suffix[path.suffix.lower()]


def _writers() -> dict[str, type[AnimationWriter]]:
    """The writers by the suffixes they take."""
    names = sorted(module.name for module in iter_modules(writers.__path__))
    found = [import_module(f"{writers.__name__}.{name}").Writer for name in names]
    return {suffix: writer for writer in found for suffix in writer.suffixes}
