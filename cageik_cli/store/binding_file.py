"""Binding files: the weights of a model in a cage, with both meshes, fully checked when read."""

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cageik_cli.cages.bind import MAX_REPRODUCTION_ERROR
from cageik_cli.cages.check.faults import validate_cage
from cageik_cli.fit.fitted import FittedWeights
from cageik_cli.fit.settings import FitRecord
from cageik_cli.formats.base.hdf5 import open_checked
from cageik_cli.method.weights.binding import Binding, Correction, WeightQuality
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.store.fit_fields import (
    read_fit_record,
    read_low_rank,
    read_offset_mark,
    read_weights,
    write_weights,
)
from cageik_cli.store.hdf5_fields import (
    check_format,
    create_hdf5,
    has_format,
    read_meshes,
    read_notes,
    read_record,
    read_sources,
    read_version,
    to_json,
    write_meshes,
)
from cageik_cli.util.errors import FormatError
from cageik_cli.util.outputs import atomic_file
from cageik_cli.util.version import __version__

if TYPE_CHECKING:
    from cageik_cli.fit.transferred import TransferredChange  # needs scipy

BINDING_FORMAT, BINDING_SCHEMA = "cageik.binding", 1
"""What a binding file says that it is; raise the number when older versions cannot read it."""


@dataclass(frozen=True, slots=True, eq=False)
class StoredBinding:
    """A binding with what is known of where it comes from.

    Files hold neither what was judged, nor weights before a fit, nor a transferred change.

    Attributes
    ----------
    sources : dict
        Name and digest of the cage and of the rest pose.
    version : str
        Of the program that wrote it.
    has_loose_cage : bool, optional
        Whether the cage has far too much room for the model; None if that was not judged.
    fit : FitRecord, optional
        How the weights were fitted to clips; None if they were computed.
    low_rank : Correction, optional
        What a fit of low rank has added to the computed weights.
    unfitted : Binding, optional
        The same model with the weights before the fit, if they are known.
    transferred : TransferredChange, optional
        What was added to the computed weights from the fit of another model.
    """

    binding: Binding
    sources: dict[str, Any]
    version: str = __version__
    has_loose_cage: bool | None = None
    fit: FitRecord | None = None
    low_rank: Correction | None = None
    unfitted: Binding | None = None
    transferred: "TransferredChange | None" = None

    def with_fit(self, fitted: FittedWeights) -> "StoredBinding":
        """Return it with fitted weights, and the record of their fit."""
        return replace(
            self,
            binding=fitted.binding,
            fit=fitted.fit,
            low_rank=fitted.low_rank,
            unfitted=fitted.unfitted,
        )


def write_binding(path: Path, stored: StoredBinding, overwrite: bool) -> None:
    """Write a binding file, completely or not at all; the same binding gives the same bytes."""
    binding = stored.binding
    with atomic_file(path, overwrite) as sink, create_hdf5(sink) as file:
        write_meshes(file, binding.rest, binding.cage)
        write_weights(file, binding, stored.fit, stored.low_rank)
        file.attrs.update(format=BINDING_FORMAT, schema=BINDING_SCHEMA, version=stored.version)
        file.attrs["settings"] = to_json(asdict(binding.settings))
        file.attrs["quality"] = to_json(asdict(binding.quality))
        file.attrs["notes"] = to_json(binding.notes)
        file.attrs["sources"] = to_json(stored.sources)


def is_binding(path: Path) -> bool:
    """Return whether an HDF5 file says that it is a binding of cageik."""
    with open_checked(path) as file:
        return has_format(file, BINDING_FORMAT)


def read_binding(path: Path) -> StoredBinding:
    """Read and check a binding file.

    Raises
    ------
    InputError
        When it is not HDF5, not a binding, of another schema or damaged, or its weights do not have
        the recorded quality.
    """
    with open_checked(path) as file:
        check_format(file, BINDING_FORMAT, BINDING_SCHEMA, "a binding of cageik bind")
        rest, cage = read_meshes(file)
        if validate_cage(cage)[0] is not cage:
            raise FormatError("the faces of the cage point inward, expected outward; bind again")
        shape = (len(rest.vertices), len(cage.vertices))
        quality, fit = read_record(file, "quality", WeightQuality), read_fit_record(file)
        for name in ("panels", "projected"):
            if (count := getattr(quality, name)) < 0:
                raise FormatError(f"`quality.{name}` is {count}, expected a count; bind again")
        binding = Binding(
            rest=rest,
            cage=cage,
            weights=read_weights(file, *shape),
            settings=read_record(file, "settings", BindSettings),
            panels=quality.panels,
            estimated_error=quality.estimated_error,
            projected=quality.projected,
            notes=read_notes(file),
            has_offsets=read_offset_mark(file),
        )
        low_rank = read_low_rank(file, fit, *shape)
        _check_weights(binding, quality)
        sources, version = read_sources(file), read_version(file)
        if not all("name" in sources.get(key, ()) for key in ("cage", "rest")):
            raise FormatError("attribute `sources` does not name cage and rest; bind again")
        return StoredBinding(binding, sources, version, fit=fit, low_rank=low_rank)


def read_bind_settings(path: Path) -> BindSettings:
    """Read how the weights of a binding file were computed, without reading them."""
    with open_checked(path) as file:
        check_format(file, BINDING_FORMAT, BINDING_SCHEMA, "a binding of cageik bind")
        return read_record(file, "settings", BindSettings)


def _check_weights(binding: Binding, stated: WeightQuality) -> None:
    """Refuse weights that cannot be trusted, or do not have the `stated` quality."""
    found = binding.quality
    for name in ("partition_of_unity", "linear_precision", "min_weight"):
        value, expected = getattr(found, name), getattr(stated, name)
        # Metrics of the same weights differ by rounding between machines.
        if not np.isclose(value, expected, rtol=1e-9, atol=1e-12):
            raise FormatError(
                f"`weights` are damaged ({name} is {value:.3g}, attribute `quality` says "
                f"{expected:.3g}); bind again"
            )
    # Vertices outside the cage have the weights of other points than themselves.
    is_exact = not (found.projected or binding.has_offsets)
    trusted = ("partition_of_unity", *(["linear_precision"] if is_exact else []))
    for name in trusted:
        if not getattr(found, name) <= MAX_REPRODUCTION_ERROR:
            raise FormatError(
                f"{name} of `weights` is {getattr(found, name):.3g}, expected at most "
                f"{MAX_REPRODUCTION_ERROR:.0e}; bind again"
            )
