"""Which of the meshes in a file is meant."""

from cageik_cli.util.errors import InputError, first_few


def picked(meshes: list[str], member: str | None) -> str:
    """The mesh that `member` names, or the only one.

    Raises
    ------
    InputError
        Listing what there is to choose from.
    """
    if not meshes:
        raise InputError("holds no mesh; export one that is animated")
    if member is not None and member not in meshes:
        raise InputError(f"holds no mesh `{member}`, but {first_few(meshes)}; name one of them")
    if member is None and len(meshes) > 1:
        raise InputError(
            f"holds {len(meshes)} meshes, expected one: {first_few(meshes)}; "
            f"name the one behind the file, as in FILE::{meshes[0]}"
        )
    return meshes[0] if member is None else member
