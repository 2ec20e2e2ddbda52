"""JSON Schema of records: each type, what docstrings say, and types that say too little."""

from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any, Literal, NotRequired, TypedDict

import pytest
from jsonschema import Draft202012Validator

from cageik_cli.util.json_schema import SchemaBuilder, allow_null, describe_record, list_field_words


class Colour(StrEnum):
    RED = "red"
    BLUE = "blue"


class Place(TypedDict):
    """Where it is."""

    name: str
    page: NotRequired[int]


@dataclass(frozen=True)
class Base:
    """What all have.

    Attributes
    ----------
    size, weight : float
        How large,
        and how heavy.
    """

    size: float
    weight: float


@dataclass(frozen=True)
class Thing(Base):
    """A thing
    of two lines.

    And of two paragraphs.

    Attributes
    ----------
    count : int, optional
        How many; None if it is not known.

    Raises
    ------
    ValueError
        Never.
    """

    count: int | None
    colour: Colour = Colour.RED


CASES = [
    (bool, [True], [1, "true", None]),
    (int, [1], [1.5, "1", True]),
    (float, [1, 1.5], ["1", None, True]),
    (str, ["a"], [1, None]),
    (None | str, ["a", None], [1]),
    (Colour, ["red"], ["green", 1]),
    (Literal["a", "b"] | None, ["a", None], ["c", 1]),
    (tuple[int, ...], [[], [1, 2]], [["a"], 1, None]),
    (tuple[float, str], [[1, "a"]], [[1], [1, "a", 2], ["a", 1]]),
    (dict[str, int], [{}, {"a": 1}], [{"a": "b"}, []]),
    (Place, [{"name": "a"}, {"name": "a", "page": 1}], [{}, {"name": "a", "x": 1}, {"name": 1}]),
    (Base, [{"size": 1, "weight": 2}], [{"size": 1}, {"size": 1, "weight": 2, "x": 1}, None]),
    (tuple[Base, ...] | None, [None, []], [[None], {}]),
    (Thing, [asdict(Thing(1, 2, None))], [asdict(Thing(1, 2, "a")), asdict(Base(1, 2))]),
]


@pytest.mark.parametrize(("kind", "right", "wrong"), CASES, ids=[str(case[0]) for case in CASES])
def test_values_of_a_type_and_no_others_are_valid(kind, right, wrong):
    builder = SchemaBuilder()
    schema = builder.describe(kind) | {"$defs": builder.definitions}
    Draft202012Validator.check_schema(schema)
    check = Draft202012Validator(schema)
    assert all(map(check.is_valid, right))
    assert not any(map(check.is_valid, wrong))


@pytest.mark.parametrize("kind", [Any, dict[str, Any], dict[int, str], list, object])
def test_types_that_do_not_say_what_their_values_are_are_refused(kind):
    with pytest.raises(TypeError, match="does not say what its values are"):
        SchemaBuilder().describe(kind)


def test_the_form_of_a_type_may_be_given():
    assert SchemaBuilder({Any: {"type": "null"}}).describe(Any) == {"type": "null"}


def test_docstrings_say_what_records_and_fields_are():
    assert describe_record(Thing) == "A thing of two lines.\nAnd of two paragraphs."
    words = "How large, and how heavy."
    assert dict(list_field_words(Thing)) == {
        "size": words,
        "weight": words,
        "count": "How many; null if it is not known.",
    }
    fields = SchemaBuilder().describe_fields(Thing, ["count", "size"])
    assert list(fields) == ["count", "size"]
    assert fields["size"] == {"description": words, "type": "number"}


def test_null_is_allowed_once():
    schema = allow_null({"description": "a", "type": ["string", "null"]})
    assert schema == {"description": "a", "type": ["string", "null"]}
    refers = {"$ref": "#/$defs/A"}
    assert allow_null(allow_null(refers)) == {"anyOf": [refers, {"type": "null"}]}
