"""What is viewed, and where the edits of the page go."""

from dataclasses import dataclass, field
from pathlib import Path

from cageik_cli.cages.settings import BuildSettings
from cageik_cli.workflows.bind import WeightSettings
from cageik_cli.workflows.settings import READ, WRITTEN, CommandSettings


@dataclass(frozen=True, slots=True)
class ViewSettings(CommandSettings):
    """What is viewed, and where the edits of the page go.

    Attributes
    ----------
    target : Path
        A result, a binding file, or a rest model.
    cage : Path, optional
        The cage of a rest model; one is built if there is none, and no binding.
    binding : Path, optional
        The binding file of a rest model.
    handles : Path, optional
        A handles file that the page begins with.
    output : Path, optional
        The edited result or posed model; without it nothing is written.
    cage_output : Path, optional
        The posed cage of a model.
    handles_output : Path, optional
        The handles that were applied.
    overwrite : bool
        Whether files that exist before the first edit may be replaced.
    """

    target: Path = field(metadata=READ)
    cage: Path | None = field(default=None, metadata=READ)
    binding: Path | None = field(default=None, metadata=READ)
    handles: Path | None = field(default=None, metadata=READ)
    output: Path | None = field(default=None, metadata=WRITTEN)
    cage_output: Path | None = field(default=None, metadata=WRITTEN)
    handles_output: Path | None = field(default=None, metadata=WRITTEN)
    build: BuildSettings = field(default_factory=BuildSettings)
    weights: WeightSettings = field(default_factory=WeightSettings)
    overwrite: bool = False

    def inputs(self) -> list[Path]:
        """Return the files that are read, but handles that are saved where they were."""
        is_saved = self.overwrite and self.handles == self.handles_output
        saved = self.handles if is_saved else None
        return [path for path in CommandSettings.inputs(self) if path != saved]
