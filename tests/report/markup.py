"""Pages as trees, and checks of them."""

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from html.parser import HTMLParser
from itertools import pairwise

EMPTY = {"meta", "link", "img", "input", "br", "rect", "path"}
ADDRESSES = {"src", "href", "xlink:href", "srcset", "action", "data", "poster", "formaction"}


@dataclass
class Element:
    """An element, its attributes, and what is in it: elements and texts."""

    tag: str
    attributes: dict[str, str]
    children: list["Element | str"] = field(default_factory=list)

    def all(self, *tags: str) -> Iterator["Element"]:
        """The elements in it of these kinds, in order; all without any."""
        for child in self.children:
            if isinstance(child, Element):
                if not tags or child.tag in tags:
                    yield child
                yield from child.all(*tags)

    def by_id(self, name: str) -> "Element":
        (found,) = (element for element in self.all() if element.attributes.get("id") == name)
        return found

    @property
    def rows(self) -> list[list[str]]:
        """The texts of the cells of each row of a table in it."""
        return [[cell.text for cell in row.all("th", "td")] for row in self.all("tr")]

    @property
    def policy(self) -> str:
        """The security policy of a page."""
        (found,) = (
            meta.attributes["content"]
            for meta in self.all("meta")
            if meta.attributes.get("http-equiv") == "Content-Security-Policy"
        )
        return found

    @property
    def text(self) -> str:
        """What is read in it, spaces set once; nothing of scripts and styles."""
        if self.tag in ("script", "style"):
            return ""
        parts = [child if isinstance(child, str) else child.text for child in self.children]
        return " ".join(" ".join(parts).split())

    @property
    def source(self) -> str:
        """All text in it as it is."""
        return "".join(child if isinstance(child, str) else child.source for child in self.children)


class _Builder(HTMLParser):
    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.open = [Element("", {})]
        self.unbalanced: list[str] = []

    def handle_starttag(self, tag, attributes):
        if tag == "wbr":
            return  # where a word may be broken, which makes it no two words
        element = Element(tag, {name: value or "" for name, value in attributes})
        self.open[-1].children.append(element)
        if tag not in EMPTY:
            self.open.append(element)

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)
        if tag not in EMPTY:
            self.open.pop()

    def handle_endtag(self, tag):
        if tag in EMPTY:
            return
        if self.open[-1].tag == tag:
            self.open.pop()
        else:
            self.unbalanced.append(tag)

    def handle_data(self, data):
        children = self.open[-1].children
        if children and isinstance(children[-1], str):
            data = children.pop() + data
        children.append(data)


def parse_page(html: str) -> Element:
    """Parse a page into a tree; every element must be closed correctly."""
    builder = _Builder()
    builder.feed(html)
    builder.close()
    assert (builder.unbalanced, len(builder.open)) == ([], 1)
    return builder.open[0]


def find_faults(html: str) -> list[str]:
    """List everything in a page that fetches, runs code, or is not accessible."""
    page = parse_page(html)
    return [
        *_heading_faults(page),
        *_alternative_faults(page),
        *_table_faults(page),
        *_address_faults(page),
        *_name_faults(page),
    ]


def _heading_faults(page: Element) -> Iterator[str]:
    levels = [int(element.tag[1]) for element in page.all("h1", "h2", "h3", "h4", "h5", "h6")]
    if levels.count(1) != 1 or levels[0] != 1:
        yield "not one h1, before the others"
    for above, level in pairwise(levels):
        if level > above + 1:
            yield f"h{level} after h{above}"


def _alternative_faults(page: Element) -> Iterator[str]:
    for element in page.all("img"):
        if not element.attributes.get("alt"):
            yield "img without alt"
    for element in page.all("svg"):
        if element.attributes.get("aria-hidden") != "true" and not (
            element.attributes.get("role") == "img" and element.attributes.get("aria-label")
        ):
            yield "svg without a text"
    for element in page.all("input"):
        labels = {label.attributes.get("for") for label in page.all("label")}
        if element.attributes.get("id") not in labels:
            yield "input without a label"


def _table_faults(page: Element) -> Iterator[str]:
    for table in page.all("table"):
        if not any(caption.text for caption in table.all("caption")):
            yield "table without a caption"
        widths = {
            sum(int(cell.attributes.get("colspan", 1)) for cell in row.all("th", "td"))
            for row in table.all("tr")
        }
        if len(widths) > 1:
            yield f"rows of {sorted(widths)} cells"
    for title in page.all("th"):
        if title.attributes.get("scope") not in ("col", "row"):
            yield "th without scope"


def _address_faults(page: Element) -> Iterator[str]:
    for element in page.all():
        for name, value in element.attributes.items():
            if name in ADDRESSES and not value.startswith(("#", "data:", "./")):
                yield f"{element.tag} {name}={value}"
            if name.startswith("on"):
                yield f"{element.tag} {name}"
        if element.tag in ("style", "script") and re.search(
            r"url\(|@import|https?:", element.source
        ):
            yield f"{element.tag} that fetches"


def _name_faults(page: Element) -> Iterator[str]:
    names = Counter(e.attributes["id"] for e in page.all() if "id" in e.attributes)
    yield from (f"two of id {name}" for name, count in names.items() if count > 1)
    for element in page.all():
        for key in ("aria-labelledby", "data-filters", "data-counts"):
            if key in element.attributes and element.attributes[key] not in names:
                yield f"{key} of nothing"
        link = element.attributes.get("href", "")
        if link.startswith("#") and link[1:] not in names:
            yield f"link to {link}"
