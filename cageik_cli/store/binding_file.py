"""Binding files: the weights of a model in a cage, with both meshes, read with every check."""

from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from cageik_cli import __version__
from cageik_cli.cages.bind import WORST_PRECISION
from cageik_cli.cages.soundness import checked_cage
from cageik_cli.coordinates.binding import Binding, BindSettings, WeightQuality
from cageik_cli.formats.base.hdf5 import numbers, opened
from cageik_cli.store.hdf5_fields import (
    as_json,
    calls_itself,
    new_file,
    parsed,
    parsed_notes,
    parsed_quality,
    parsed_sources,
    read_meshes,
    refuse_others,
    version_of,
    write_deflated,
    write_meshes,
)
from cageik_cli.util.errors import InputError
from cageik_cli.util.outputs import whole_file

FORMAT = "cageik.binding"
SCHEMA = 1

ROUNDING = 1e-12
"""By how much figures of the same weights may differ between machines."""


@dataclass(frozen=True, slots=True, eq=False)
class StoredBinding:
    """What a binding file says.

    Attributes
    ----------
    binding : Binding
    sources : dict
        Name and digest of the cage and of the rest pose.
    version : str
        Of the program that wrote it.
    """

    binding: Binding
    sources: dict[str, Any]
    version: str = __version__


def write_binding(path: Path, stored: StoredBinding, overwrite: bool) -> None:
    """Write a binding, whole or not at all; the same one always as the same bytes.

    Raises
    ------
    InputError
        When it cannot be written, or another file has come to have the name meanwhile.
    """
    binding = stored.binding
    with whole_file(path, overwrite) as sink, new_file(sink) as file:
        write_meshes(file, binding.rest, binding.cage)
        write_deflated(file, "weights", binding.weights)
        file.attrs.update(format=FORMAT, schema=SCHEMA, version=stored.version)
        file.attrs["settings"] = as_json(asdict(binding.settings))
        file.attrs["quality"] = as_json(asdict(binding.quality))
        file.attrs["notes"] = as_json(binding.notes)
        file.attrs["sources"] = as_json(stored.sources)


def is_binding(path: Path) -> bool:
    """Whether an HDF5 file calls itself one of our bindings."""
    with opened(path) as file:
        return calls_itself(file, FORMAT)


def read_binding(path: Path) -> StoredBinding:
    """Read and check a binding file.

    Raises
    ------
    InputError
        When it is not HDF5, not a binding, of another schema, damaged, or its weights are not
        those that its figures were taken of.
    """
    with opened(path) as file:
        refuse_others(file, FORMAT, SCHEMA, "a binding of cageik bind")
        rest, cage = read_meshes(file)
        if checked_cage(cage)[0] is not cage:
            raise InputError("the cage's faces turn inward, expected outward; make it again")
        shape = (len(rest.vertices), len(cage.vertices))
        quality = parsed_quality(file, WeightQuality)
        binding = Binding(
            rest=rest,
            cage=cage,
            weights=numbers(file, "weights", "f", shape).astype(np.float64, copy=False),
            settings=_settings(file),
            panels=_count(quality, "panels"),
            estimated_error=quality.estimated_error,
            projected=_count(quality, "projected"),
            notes=parsed_notes(file),
        )
        _refuse_other_weights(binding, quality)
        return StoredBinding(binding, _sources(file), version_of(file))


def read_bind_settings(path: Path) -> BindSettings:
    """How the weights of a binding file were asked for, without reading them.

    Raises
    ------
    InputError
        When it is not a binding.
    """
    with opened(path) as file:
        refuse_others(file, FORMAT, SCHEMA, "a binding of cageik bind")
        return _settings(file)


def _settings(file: h5py.File) -> BindSettings:
    held = parsed(file, "settings", dict)
    expected = {field.name for field in fields(BindSettings)}
    if set(held) != expected or not all(isinstance(value, str) for value in held.values()):
        raise InputError(f"attribute `settings` does not say {', '.join(sorted(expected))}")
    return BindSettings(**held)


def _sources(file: h5py.File) -> dict[str, Any]:
    sources = parsed_sources(file)
    if not all("name" in sources.get(key, ()) for key in ("cage", "rest")):
        raise InputError("attribute `sources` does not name cage and rest; make it again")
    return sources


def _count(quality: WeightQuality, name: str) -> int:
    value = getattr(quality, name)
    if not isinstance(value, int) or value < 0:
        raise InputError(f"attribute `quality` says that {name} is {value!r}, expected a count")
    return value


def _refuse_other_weights(binding: Binding, stated: WeightQuality) -> None:
    """Refuse weights that cannot be trusted, or are not those of the `stated` figures."""
    if not np.isfinite(binding.weights).all():
        row = int(np.argmin(np.isfinite(binding.weights).all(axis=1)))
        raise InputError(f"`weights` are not finite at vertex {row}; make it again")
    found = binding.quality
    for name in ("partition_of_unity", "linear_precision", "min_weight"):
        value, expected = getattr(found, name), getattr(stated, name)
        if not np.isclose(value, expected, rtol=1e-9, atol=ROUNDING):
            raise InputError(
                f"`weights` have {name} {value:.3g} where attribute `quality` says "
                f"{expected:.3g}; it is damaged, make it again"
            )
    # Vertices that were outside have the weights of other points than themselves.
    trusted = ("partition_of_unity",) if found.projected else (
        "partition_of_unity", "linear_precision"
    )  # fmt: skip
    for name in trusted:
        if not getattr(found, name) <= WORST_PRECISION:
            raise InputError(
                f"`weights` have {name} {getattr(found, name):.3g}, expected at most "
                f"{WORST_PRECISION:.0e}; make it again"
            )
