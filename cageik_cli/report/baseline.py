"""Figures of an earlier run, out of the JSON of a report, of several, or of a batch."""

import json
import math
from collections.abc import Iterator
from decimal import Decimal
from pathlib import Path
from typing import Any, NoReturn

from cageik_cli.report.limits import Baseline
from cageik_cli.report.record import SCHEMA
from cageik_cli.util.errors import InputError, located
from cageik_cli.util.text import bytes_text

MOST_BYTES = 256 << 20
"""Of a file that is read."""

FIGURES = {
    "rms": "rms_percent",
    "frame_rms": "worst_frame_rms_percent",
    "max_deviation": "max_deviation_percent",
    "volume_change": "volume_change_percent_max",
}
"""The metrics that are compared, and the summary's names of them in percent."""

_KINDS: dict[type, str] = {dict: "an object", list: "a list", str: "a text"}


def read_baseline(path: Path, regression: Decimal) -> Baseline:
    """Read what results are to be compared with.

    Parameters
    ----------
    path : Path
        What `cageik report --json` wrote, of one result or several, or the report.json of a batch,
        whose failed clips have no figures.
    regression : Decimal
        By how many percent its figures may be passed.

    Raises
    ------
    InputError
        Naming the file, and the place in it that is not what it should be.
    """
    with located(path):
        figures: dict[str, dict[str, float | None]] = {}
        for name, found in _results(_loaded(path)):
            if name in figures:
                raise InputError(
                    f"holds two results of the name {name}, expected one of each; "
                    "report on results of different names, or batch them"
                )
            figures[name] = found
        if not figures:
            raise InputError("holds no result with figures; expected at least one")
    return Baseline(path, figures, regression)


def _loaded(path: Path) -> Any:
    try:
        size = path.stat().st_size
        if not path.is_file():
            raise InputError("is not a plain file; name the JSON of an earlier report")
        if size > MOST_BYTES:
            raise InputError(
                f"is of {bytes_text(size)}, more than the {bytes_text(MOST_BYTES)} that are read; "
                "name the JSON of an earlier report"
            )
        return json.loads(path.read_text(encoding="utf-8-sig"), parse_constant=_no_number)
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror or error}); check the path") from error
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"cannot be read as JSON ({error}); name the JSON of an earlier report"
        ) from error


def _no_number(word: str) -> NoReturn:
    raise ValueError(f"{word} is not a number of JSON")


def _results(document: Any) -> Iterator[tuple[str, dict[str, float | None]]]:
    """Name and figures of each result that has figures."""
    if isinstance(document, list):
        for k, record in enumerate(document):
            with located(f"[{k}]"):
                yield _record(_checked(record, dict))
    elif "clips" in _checked(document, dict):
        _check_schema(document)
        for k, entry in enumerate(_member(document, "clips", list)):
            with located(f"clips[{k}]"):
                if _checked(entry, dict).get("summary") is not None:
                    yield _member(entry, "name", str), _figures(entry)
    else:
        yield _record(document)


def _record(record: dict[str, Any]) -> tuple[str, dict[str, float | None]]:
    _check_schema(record)
    return _member(record, "result", str), _figures(record)


def _check_schema(record: dict[str, Any]) -> None:
    schema = record.get("schema")
    if schema != SCHEMA or isinstance(schema, bool):
        raise InputError(
            f"schema is {_short(schema)}, expected {SCHEMA}; name the JSON of cageik report or "
            "cageik batch, of this version"
        )


def _figures(record: dict[str, Any]) -> dict[str, float | None]:
    summary = _member(record, "summary", dict)
    return {metric: _figure(summary, metric, name) for metric, name in FIGURES.items()}


def _figure(summary: dict[str, Any], metric: str, name: str) -> float | None:
    value = summary.get(name)
    if metric == "volume_change" and value is None and name in summary:
        return None
    size = _finite(value)
    if size is not None and metric == "volume_change":
        size = abs(size)
    if size is None or size < 0:
        expected = " or null" if metric == "volume_change" else ", zero or above"
        raise InputError(f"summary.{name} is {_short(value)}, expected a finite number{expected}")
    return size


def _finite(value: Any) -> float | None:
    """A number of JSON; None if it is none, or too large for one here."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None


def _member(record: dict[str, Any], name: str, kind: type) -> Any:
    with located(name):
        return _checked(record.get(name), kind)


def _checked(value: Any, kind: type) -> Any:
    if not isinstance(value, kind):
        raise InputError(
            f"is {_short(value)}, expected {_KINDS[kind]}; name the JSON of cageik report or "
            "cageik batch"
        )
    return value


def _short(value: Any) -> str:
    """A value as JSON, cut when long."""
    text = json.dumps(value)
    return text if len(text) <= 40 else f"{text[:37]}..."
