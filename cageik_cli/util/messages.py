"""What is said to the user: texts that name settings, and notes.

A text keeps the settings that it names apart from its words, as each front end writes them in its
own way: the Python API as keywords, the command line as options. Names of files and of users are
words, whatever they look like. This module is imported by every start, so it imports little.
"""

import re
from collections.abc import Callable, Iterable
from typing import Any


class Text:
    """Words, and hints between them; `+` joins them to one text.

    Parameters
    ----------
    parts : str or Hint
        In their order.

    Examples
    --------
    >>> text = "cage.obj: exists already; " + say("replace it with `overwrite=True`")
    >>> print(text)
    cage.obj: exists already; replace it with `overwrite=True`
    >>> spell(text, lambda hint: "--" + hint.name)
    'cage.obj: exists already; replace it with --overwrite'
    """

    __slots__ = ("parts",)

    def __init__(self, *parts: "str | Hint") -> None:
        joined: list[str | Hint] = []
        for part in parts:
            if isinstance(part, str) and joined and isinstance(joined[-1], str):
                joined[-1] += part
            elif part:
                joined.append(part)
        self.parts = tuple(joined)

    def __bool__(self) -> bool:
        return bool(self.parts)

    def __add__(self, other: "Said") -> "Text":
        return Text(*self.parts, *_parts_of(other))

    def __radd__(self, other: str) -> "Text":
        return Text(other, *self.parts)

    def __str__(self) -> str:
        """Return the text as the Python API shows it."""
        return spell(self)

    def format(self, **values: object) -> "Text":
        """Return the text with values in place of their names in braces."""
        return Text(*(part.format(**values) for part in self.parts))

    def __repr__(self) -> str:
        return f"Text({', '.join(map(repr, self.parts))})"

    def __eq__(self, other: object) -> bool:
        """Return whether the other, a text or words, is shown as this is."""
        return isinstance(other, str | Text) and str(self) == str(other)

    def __hash__(self) -> int:
        return hash(str(self))


class Hint(Text):
    """A setting that a text names, and the value to give it, if the text says one.

    Parameters
    ----------
    name : str
        Of a parameter.
    value : object
        What to give; True for a flag.
    """

    __slots__ = ("name", "value")

    def __init__(self, name: str, value: object = "") -> None:
        self.name, self.value = name, str(value)
        self.parts = (self,)

    def format(self, **values: object) -> "Hint":
        """Return the hint with values in place of their names in braces."""
        return Hint(self.name, self.value.format(**values))

    def __repr__(self) -> str:
        return f"Hint({self.name!r}, {self.value!r})"

    def __reduce__(self) -> Any:
        return Hint, (self.name, self.value)


Said = str | Text
"""What a message is made of."""

Row = tuple[str, Said]
"""A label, and what is said."""

Spelling = Callable[[Hint], str]
"""How a front end writes a hint."""


def say(words: str) -> Text:
    """Return the text of words that stand in the code, with settings as keywords in backticks.

    Nothing else is taken apart: what is not known before is added to the text.
    """
    plain, *others = re.split(r"`([a-z_]+)=([^`]*)`", words)
    parts: list[str | Hint] = [plain]
    for name, value, after in zip(others[::3], others[1::3], others[2::3], strict=True):
        parts += [Hint(name, value), after]
    return Text(*parts)


def spell_keyword(hint: Hint) -> str:
    """Write a hint as the Python API does: as a keyword in backticks."""
    return f"`{hint.name}={hint.value}`"


def spell(said: Said, spelling: Spelling = spell_keyword) -> str:
    """Return a text in the words of a front end."""
    return "".join(part if isinstance(part, str) else spelling(part) for part in _parts_of(said))


def join_texts(separator: str, texts: Iterable[Said]) -> Text:
    """Join texts, as `str.join` does."""
    parts: list[str | Hint] = []
    for text in texts:
        parts += [*([separator] if parts else []), *_parts_of(text)]
    return Text(*parts)


def collapse_spaces(said: Said) -> Said:
    """Return a text on one line, with single spaces between words."""
    if isinstance(said, str):
        return " ".join(said.split())
    return map_words(lambda words: re.sub(r"\s+", " ", words), said)


class Note:
    """A sentence on what was found or changed, or a warning.

    Parameters
    ----------
    text : str or Text
        The sentence.
    kind : str
        `note` or `warning`.
    place : str
        The file that it is about, or ""; `at` adds the place around it.

    Examples
    --------
    >>> from cageik_cli import Note
    >>> note = Note("the faces turn inward", "warning", "cage.obj")
    >>> print(note)
    warning: cage.obj: the faces turn inward
    """

    __slots__ = ("kind", "place", "text")

    def __init__(self, text: Said, kind: str = "note", place: str = "") -> None:
        self.text, self.kind, self.place = text, kind, place

    def at(self, place: str) -> "Note":
        """Return the note with a place around the one that it has."""
        return Note(self.text, self.kind, f"{place}: {self.place}" if self.place else place)

    @property
    def located(self) -> Said:
        """The text, behind its place."""
        return f"{self.place}: " + self.text if self.place else self.text

    @property
    def row(self) -> tuple[str, Said]:
        """The kind and the located text, as a labelled row."""
        return self.kind, self.located

    def spell(self, spelling: Spelling) -> "Note":
        """Return the note in the words of a front end."""
        return Note(spell(self.text, spelling), self.kind, self.place)

    def pack(self) -> dict[str, Any]:
        """Return the note as plain values; a hint is a list of its name and its value."""
        return {"kind": self.kind, "place": self.place, "text": pack_parts(self.text)}

    @staticmethod
    def unpack(packed: Any) -> "Note":
        """Return the note of plain values; of a sentence, as files had them before, a note.

        Raises
        ------
        ValueError
            When they are not those of a note.
        """
        if isinstance(packed, str):
            is_warning = packed.startswith("warning: ")
            text = say(packed.removeprefix("warning: "))
            return Note(text, "warning" if is_warning else "note")
        match packed:
            case {"kind": "note" | "warning" as kind, "place": str(place), "text": list(parts)}:
                return Note(unpack_parts(parts), kind, place)
        raise ValueError("an entry that is not a note")

    def __str__(self) -> str:
        return spell(f"{self.kind}: " + self.located if self.kind != "note" else self.located)

    def __repr__(self) -> str:
        return f"Note({self.text!r}, {self.kind!r}, {self.place!r})"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Note) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    @property
    def _key(self) -> tuple[object, ...]:
        return self.kind, self.place, str(self.text)


def map_words(change: Callable[[str], str], said: Said) -> Said:
    """Return a text with other words, and the same hints."""
    if isinstance(said, str):
        return change(said)
    return Text(*(change(part) if isinstance(part, str) else part for part in said.parts))


def pack_parts(said: Said) -> list[Any]:
    """Return the parts of a text as plain values; a hint is a list of its name and its value."""
    return [part if isinstance(part, str) else [part.name, part.value] for part in _parts_of(said)]


def unpack_parts(packed: list[Any]) -> Text:
    """Return the text of such values; raises ValueError for others."""
    parts: list[str | Hint] = []
    for one in packed:
        match one:
            case str():
                parts.append(one)
            case [str(name), str(value)]:
                parts.append(Hint(name, value))
            case _:
                raise ValueError("an entry that is not a note")
    return Text(*parts)


def _parts_of(said: Said) -> tuple[str | Hint, ...]:
    return (said,) if isinstance(said, str) else said.parts
