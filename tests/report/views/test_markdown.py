"""Markdown: worst first, bounded in size, with names escaped."""

import html
import re

import pytest
from markdown_it import MarkdownIt

from cageik_cli.report.overview import ClipEntry, Overview
from cageik_cli.report.views.markdown import MAX_TEXT_LENGTH, format_markdown
from tests.report.clips import HOSTILE, clip, gate, poor

RENDERER = MarkdownIt("commonmark").enable(["table", "strikethrough"])


def table_cells(text: str) -> list[list[str]]:
    """Return the texts in the rows of the table."""
    rows = re.findall(r"<tr>(.*?)</tr>", RENDERER.render(text), re.DOTALL)
    return [
        [html.unescape(cell) for cell in re.findall(r"<td[^>]*>(.*?)</td>", row, re.DOTALL)]
        for row in rows[1:]
    ]


def list_items(text: str) -> list[str]:
    return [
        html.unescape(i) for i in re.findall(r"<li>(.*?)</li>", RENDERER.render(text), re.DOTALL)
    ]


CLIPS = (
    clip("fine", gate(True), rms_percent=0.1),
    clip("worse", gate(True), rms_percent=0.3, notes=["one"]),
    clip("over", gate(True), gate(False), rms_percent=0.2, notes=["one", "two"]),
    ClipEntry("broken", fault="frame_3.obj: is empty"),
    clip("plain", gate(None), rms_percent=0.01),
)


def test_poor_clips_are_marked():
    text = format_markdown(Overview([poor("a", gate(True)), poor("b", better="--fit")]))
    assert text.startswith("## cageik: 2 clips: 1 poor, within limits, 1 poor\n")
    verdicts = [row[1] for row in table_cells(text)]
    assert verdicts == ["<strong>poor, within limits</strong>", "<strong>poor</strong>"]
    assert list_items(text) == ["poor: a", "poor: b; better: --fit"]


def test_the_worst_clips_come_first_with_their_reasons():
    text = format_markdown(Overview(CLIPS))
    assert text.startswith(
        "## cageik: 5 clips: 1 failed, 1 over limit, 2 within limits, 1 extracted\n\n| clip |"
    )
    assert [row[:3] for row in table_cells(text)] == [
        ["broken", "<strong>failed</strong>", ""],
        ["over", "<strong>over limit</strong>", "0.2000"],
        ["worse", "within limits", "0.3000"],
        ["fine", "within limits", "0.1000"],
        ["plain", "extracted", "0.0100"],
    ]
    assert table_cells(text)[1][3:] == ["0.3000", "f_7.obj", "1.0000", "-1.4400"]
    assert list_items(text) == [
        "broken: frame_3.obj: is empty",
        "over: rms 0.7500 %, limit 0.5 %, worst frame f_7.obj",
        "over, worse: one",
        "over: two",
    ]


def test_a_note_names_the_first_clips_that_have_it_and_counts_the_others():
    clips = [clip(f"clip_{k}", notes=["gap", "gap"], rms_percent=9 - k) for k in range(5)]
    text = format_markdown(Overview([*clips, clip("other", notes=["once"])], ["on the run"]))
    assert list_items(text) == [
        "on the run",
        "clip_0, clip_1, clip_2 and 2 more: gap",
        "other: once",
    ]


def test_empty_parts_have_no_heading():
    text = format_markdown(Overview([clip("a")]))
    assert text.startswith("## cageik: 1 clip: 1 extracted\n")
    assert "###" not in text


def seen(name: str) -> str:
    """Return the visible form of a name."""
    line = "".join(" " if c.isspace() else c if c.isprintable() else "\ufffd" for c in name).strip()
    return line if len(line) <= MAX_TEXT_LENGTH else line[: MAX_TEXT_LENGTH - 1] + "…"


@pytest.mark.parametrize("name", HOSTILE.values(), ids=HOSTILE)
def test_names_are_rendered_as_they_are(name):
    entries = [
        clip(name, gate(False, frame=name), notes=[f"{name} note"]),
        ClipEntry(name, fault=name),
    ]
    text = format_markdown(Overview(entries))
    assert [row[0] for row in table_cells(text)] == [seen(name)] * 2
    assert list_items(text)[0] == f"{seen(name)}: {seen(name)}".strip()
    rendered = RENDERER.render(text)
    assert not re.search(r"<(img|a|em|code|del|b|ol|h1)\b", rendered)
    assert len(list_items(text)) == 3


def test_names_of_frames_are_rendered_as_they_are():
    for name in HOSTILE.values():
        entry = clip("a", worst_frame=name)
        assert table_cells(format_markdown(Overview([entry])))[0][4] == seen(name)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["clip_", "ü|<>" * 60, "\U0001f600" * 290], ids=range(3))
def test_any_number_of_clips_fits(name):
    """Failed clips and those over a limit come first; clips without room are counted."""
    clips = [
        clip(f"{k} {name}", gate(k % 40 > 0), notes=[f"{k} {name} note"])
        if k % 100
        else ClipEntry(f"{k} {name}", fault="it is broken " * 50)
        for k in range(2000)
    ]
    text = format_markdown(Overview(clips))
    assert len(text.encode()) < 60_000
    assert "## cageik: 2 000 clips: 20 failed, 40 over limit, 1 940 within limits\n" in text
    *rows, last = table_cells(text)
    assert len(rows) > 15
    assert last[0] == f"and {2000 - len(rows):,} more".replace(",", " ")
    expected = ["<strong>failed</strong>"] * 20 + ["<strong>over limit</strong>"] * 40
    expected += ["within limits"] * 1940
    assert [row[1] for row in rows] == expected[: len(rows)]
    for heading in ("Failed", "Over a limit", "Notes"):
        assert f"### {heading}\n" in text


def test_a_few_clips_are_all_shown():
    text = format_markdown(Overview([clip(f"clip_{k}", gate(False)) for k in range(100)]))
    assert " more" not in text
    assert len(table_cells(text)) == 100
