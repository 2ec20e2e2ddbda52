"""The lines that people read: what stands in them, how many there are, and how wide."""

from dataclasses import replace

import pytest

from cageik_cli.report.figures import KeptSummary
from cageik_cli.report.record import build_report
from cageik_cli.report.regions import PartRecord
from cageik_cli.report.views.front import MAX_FRONT_WIDTH, format_brief, format_front
from cageik_cli.util.messages import Note


@pytest.fixture(scope="module")
def report(closed):
    return build_report(closed.result)


def find_row(text: str, label: str) -> str:
    """The text of the only line with a label."""
    (row,) = [line for line in text.splitlines() if line[2:12].strip() == label]
    return row[12:]


def test_a_plain_result_has_few_lines_that_are_not_wide(report):
    lines = format_front(report, seconds=3.5).splitlines()
    assert len(lines) <= 5
    assert max(map(len, lines)) <= MAX_FRONT_WIDTH
    assert lines[0] == "cages.h5: 5 frames, 18 vertices, a cage of 8 that was given, 3.5 s"


@pytest.mark.parametrize(
    ("metres", "average"),
    [(1.0, "16 cm of 3.46 m"), (0.01, "1.6 mm of 3.46 cm"), (0.0254, "0.16 in of 3.46 in"),
     (0.3, "0.16 of 3.46")],
)  # fmt: skip
def test_lengths_are_in_the_unit_of_the_scene(report, metres, average):
    known = replace(report, clip=replace(report.clip, metres_per_unit=metres))
    assert f"({average})" in find_row(format_front(known), "quality")


def test_frames_are_named_by_their_numbers(report):
    frames = tuple(replace(frame, number=1001 + 2 * frame.index) for frame in report.frames)
    worst = frames[report.summary.worst_frame_index]
    text = format_front(replace(report, frames=frames))
    assert f"worst frame {worst.number}: " in find_row(text, "quality")
    assert find_row(text, "look at").startswith("frame 100")


def test_what_was_rejected_does_not_count(report):
    kept = KeptSummary(0.2, 1.0, 19.57, 3, "a", 0.94, 2, "b")
    frames = tuple(
        replace(frame, rms_kept_percent=0.2, max_deviation_kept_percent=float(frame.index))
        for frame in report.frames
    )
    text = format_front(replace(report, kept=kept, frames=frames))
    assert "0.20 % of the size" in find_row(text, "quality")
    assert "20 % of the vertices are missing, and 0.94 % " in find_row(text, "data")
    assert find_row(text, "look at").startswith(f"frame {frames[-1].number:g}: 4.0 % (")


@pytest.mark.parametrize(
    ("missing", "rejected", "words"),
    [(2.0, 0.0, "2.0 % of the vertices are missing; they do not count here"),
     (0.0, 0.5, "0.50 % of the vertices are rejected; they do not count here"), (0.0, 0.0, None)],
)  # fmt: skip
def test_of_the_data_only_what_was_left_out_is_told(report, missing, rejected, words):
    kept = KeptSummary(0.2, 1.0, missing, 3, "a", rejected, 2, "b")
    frames = tuple(
        replace(frame, rms_kept_percent=0.2, max_deviation_kept_percent=1.0)
        for frame in report.frames
    )
    told = replace(report, kept=kept, frames=frames, notes=(Note("a word " * 30),))
    text = format_front(told)
    assert find_row(text, "data") == words if words else "data" not in text
    assert len(text.splitlines()) <= 6  # and three on what was written, and what comes next


def test_a_probable_cause_is_told_and_an_unknown_one_is_not(report):
    assert find_row(format_front(report), "look at").endswith("the cage is far away")
    unknown = tuple(replace(region, cause="unknown") for region in report.regions)
    assert "known" not in find_row(format_front(replace(report, regions=unknown)), "look at")
    assert "near" not in find_row(format_front(replace(report, regions=None)), "look at")


def test_parts_and_places_that_fit_no_line_are_left_out(report):
    """A verdict has a line for each row; before, a model of parts had ten lines in all."""
    parts = (PartRecord("a hat", 0, 18, 0.1, 5.0),)
    text = format_front(replace(report, parts=parts))
    assert "worst part a hat: 5.0 %" in find_row(text, "quality")
    for length in (20, 60):
        long = (replace(parts[0], name="x" * length),)
        lines = format_front(replace(report, parts=long)).splitlines()
        labels = [line[:10].strip() for line in lines[1:]]
        assert labels == ["quality", "look at", "better", "notes"]
        assert ("worst part x" in lines[1], "worst frame" in lines[1]) == (
            length == 20,
            length == 60,
        )
        assert lines[2].endswith("the cage is far away")


def test_an_edit_is_not_judged(edited):
    text = format_front(build_report(edited))
    assert "edited from" in text
    assert "quality" not in text
    assert "better" not in text
    assert " % of the size" in find_row(text, "moved")


def test_notes_are_counted_and_cut_and_warnings_come_first(report):
    def show(*notes, told=()):
        given = tuple(one if isinstance(one, Note) else Note(one) for one in notes)
        text = format_front(replace(report, notes=given), told)
        assert max(map(len, text.splitlines())) <= MAX_FRONT_WIDTH
        return [line[12:] for line in text.splitlines()[4:]]

    long, middle = "a part " * 60, "one half " * 12
    assert show(
        "short", Note("one is off", "warning"), told=[("cage", "built"), ("note", "short")]
    ) == ["2: warning: one is off; short (`verbose=True` shows all)"]
    fitting = "a note that just fits in one line of the front " * 2 + "3"
    assert show(fitting) == [f"1: {fitting}"]
    assert show("short", middle, long)[0].startswith("3: short; one half one half")
    assert len(show("short", middle, long)) == 2
    assert " ... (`verbose=True` shows all)" in show(long)[-1]
    assert show() == ["none (`verbose=True` shows all figures)"]


def test_a_skipped_frame_is_a_warning(report):
    first, *others = report.frames
    skipped = replace(first, skipped="cannot be read", rms=None)
    text = format_front(replace(report, frames=(skipped, *others)))
    assert "warning: 1 of 5 frames skipped: cannot be read" in find_row(text, "notes")


def test_lines_of_a_command_are_brief():
    rows = [("model", "18 vertices"), ("note", "one " * 40), ("seconds", "open 1"), ("note", "two")]
    lines = format_brief("b.h5", rows).splitlines()
    assert lines[:2] == ["b.h5", "  model          18 vertices"]
    assert (len(lines), max(map(len, lines)) <= MAX_FRONT_WIDTH) == (5, True)
    many = format_brief("b.h5", [("step", "a word " * 30)] * 9 + rows).splitlines()
    assert (len(many), max(map(len, many)) <= MAX_FRONT_WIDTH) == (7, True)
    assert many[-1].startswith("  notes          2: one one")
    assert many[-1].endswith("(`verbose=True` shows all)")
    assert many[-2] == "  more           8 step (`verbose=True` shows all)"
    assert many[-3] == "  model          18 vertices"
    facts = format_brief("b.h5", [(f"step {k}", "one") for k in range(9)]).splitlines()
    more = "  more           step 6, step 7, step 8 (`verbose=True` shows all)"
    assert (len(facts), facts[-1]) == (8, more)
    assert format_brief("c.obj", [("to repair", "word " * 40)]).count("\n") == 1


def test_a_headline_is_wrapped_and_leaves_room_for_what_follows():
    rows = [(f"step {k}", "one") for k in range(9)]
    lines = format_brief("wrote a.usdc: " + "a fact, " * 20, rows, 3).splitlines()
    assert max(map(len, lines)) <= MAX_FRONT_WIDTH
    assert lines[1].startswith("  a fact,") or lines[1].startswith("  fact,")
    assert len(lines) <= 6
    path = "x" * 200
    assert format_brief(f"wrote {path}", []).split() == ["wrote", path]


def test_notes_have_two_lines_at_most():
    for length in range(60, 120):
        rows = [("step", "one")] * 5 + [("note", f"{'x' * length} {'y' * 70} {'z' * 20}")] * 2
        lines = format_brief("b.h5", [*rows, ("note", "two")]).splitlines()
        assert [line.split()[0] for line in lines].count("notes") == 1
        assert len(lines) <= 8
        assert lines[-1].endswith(" shows all)")


def test_rounding_is_called_exact_and_lines_are_short(report):
    summary = replace(report.summary, rms_percent=2e-14, max_deviation_percent=3e-13)
    text = format_front(replace(report, summary=summary))
    assert f"{report.quality}: exact\n" in text
    assert "look at" not in text
    frames = tuple(replace(one, worst_vertex=10**90) for one in report.frames)
    long = format_front(replace(report, frames=frames, parts=None))
    assert max(map(len, long.splitlines()[2:])) <= MAX_FRONT_WIDTH


@pytest.mark.parametrize(
    ("rms", "largest", "average"),
    [
        (3e-6, 2e-5, "3.0e-06 % of the size on average"),
        (2e-14, 1.0, "2.0e-14 % of the size on average"),
        (0.0, 1.0, "0 % of the size on average"),
        (0.0003, 0.01, "0.00030 % of the size on average"),
    ],
)
def test_what_is_not_exact_has_digits(report, rms, largest, average):
    summary = replace(report.summary, rms_percent=rms, max_deviation_percent=largest)
    text = format_front(replace(report, summary=summary))
    assert find_row(text, "quality").startswith(f"{report.quality}: {average}")


def test_long_lengths_have_groups_of_digits(report):
    clip = replace(report.clip, diagonal=34159.3, metres_per_unit=1.0, vertices=34159)
    text = format_front(replace(report, clip=clip))
    assert " 34 159 vertices" in text
    assert " of 34 159 m)" in text
