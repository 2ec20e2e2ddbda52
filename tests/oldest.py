"""Print the oldest versions that `pyproject.toml` allows, as constraints for pip."""

import re
import tomllib
from pathlib import Path

PROJECT = Path(__file__).parents[1] / "pyproject.toml"


def list_oldest(requirements: list[str]) -> list[str]:
    """Return each requirement as the oldest version that it allows.

    Raises
    ------
    ValueError
        For one that states no oldest version.
    """
    oldest = []
    for requirement in requirements:
        found = re.fullmatch(r"([\w.-]+)>=([\d.]+)", requirement)
        if found is None:
            raise ValueError(f"{requirement}: states no oldest version; write NAME>=VERSION")
        oldest.append(f"{found[1]}=={found[2]}")
    return oldest


if __name__ == "__main__":
    project = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]
    print("\n".join(list_oldest(project["dependencies"])))
