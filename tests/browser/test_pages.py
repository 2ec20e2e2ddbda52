"""The pages in Chromium, by mouse and keyboard; no page may have an error."""

from dataclasses import replace
from decimal import Decimal
from itertools import pairwise

import numpy as np
import pytest

from cageik_cli.report.figures import format_change, format_percent
from cageik_cli.report.html.index import render_index
from cageik_cli.report.html.page import render_page
from cageik_cli.report.limits import Limit, Limits
from cageik_cli.report.overview import ClipEntry, Overview, build_clip_entry
from cageik_cli.report.record import build_report
from cageik_cli.report.render.model_views import load_poses
from cageik_cli.run.extraction import extract
from cageik_cli.run.settings import ExtractSettings
from cageik_cli.util.messages import Note
from tests.report.clips import change, make_500_clips
from tests.report.hostile import NAMES, with_hostile_names

pytestmark = pytest.mark.browser

OPEN_IN = 2000
"""Milliseconds in which an index of 500 clips must load."""

WIDTHS = (360, 760, 1280, 1920)


@pytest.fixture(scope="session")
def result(tmp_path_factory, animation, write_obj):
    folder = tmp_path_factory.mktemp("pages")
    bend = animation.frames[:1] - animation.frames[-1:]
    waves = animation.frames[-1] + bend * np.cos(np.linspace(0, 12, 30))[:, None, None]
    frames = np.concatenate([animation.frames, waves])
    np.savez(folder / "clip.npz", verts=frames, faces=animation.rest.faces)
    cage = write_obj(folder / "cage.obj", animation.cage.vertices, animation.cage.faces)
    return extract(ExtractSettings((str(folder / "clip.npz"),), cage, folder / "cages.h5"))


@pytest.fixture(scope="session")
def report(result):
    """A report whose last frame was skipped."""
    report = build_report(result, Limits((Limit("rms", Decimal("0.001")),)))
    last = replace(with_hostile_names(report).frames[-1], name=report.frames[-1].name)
    return replace(report, frames=(*report.frames[:-1], replace(last, skipped="it was cut short")))


@pytest.fixture(scope="session")
def poses(result):
    return load_poses(result)


@pytest.fixture(scope="session")
def html(report, poses):
    return render_page(report, poses)


@pytest.fixture(scope="session")
def index(report):
    entry = build_clip_entry(report, page="clip.html")
    entries = [change(entry, f"walks/shot_{k}", rms_percent=(7 * k % 12) / 10) for k in range(12)]
    return render_index(
        Overview([*entries, ClipEntry("walks/broken", fault="it could not be read")])
    )


def _column(page, table, number, body="tbody:not(.fixed)"):
    cells = f"#{table} {body} tr > :nth-child({number})"
    return page.eval_on_selector_all(cells, "cells => cells.map(cell => cell.textContent.trim())")


def _cursor_values(page):
    """The frame's name and the values beside the cursor."""
    lines = page.eval_on_selector_all(
        "#plot .tip span", "all => all.map(one => [...one.children].map(part => part.textContent))"
    )
    return page.text_content("#plot .tip b"), lines


def _expected(frame):
    return frame.name, [
        ["rms, %", format_percent(frame.rms_percent)],
        ["max deviation, %", format_percent(frame.max_deviation_percent)],
        ["volume change, %", format_change(frame.volume_change)],
    ]


def _frame_position(page, frame):
    """Return the position of a frame in the plot, in pixels of the window."""
    page.locator("#plot").scroll_into_view_if_needed()
    box = page.locator("#plot").bounding_box()
    left, right, first, last = (
        float(page.get_attribute("#plot", f"data-{key}"))
        for key in ("left", "right", "first", "last")
    )
    share = left + (frame - first) / (last - first) * (right - left)
    return box["x"] + share * box["width"], box["y"] + box["height"] / 2


def test_a_click_sorts_the_frames_and_another_reverses_them(opened, html, report):
    page = opened(html).page
    button = page.get_by_role("button", name="RMS, %", exact=True)
    button.click()
    values = _column(page, "frames-table", 3)
    figures = [float(value) for value in values[:-1]]
    assert all(a >= b for a, b in pairwise(figures))
    assert len(figures) == len(report.frames) - 1
    assert values[-1] == "skipped: it was cut short"
    titles = page.locator("#frames-table thead th")
    assert titles.nth(2).get_attribute("aria-sort") == "descending"
    assert titles.nth(0).get_attribute("aria-sort") == "none"
    assert page.text_content("#status") == "sorted by RMS, %, descending"
    button.click()
    values = _column(page, "frames-table", 3)
    assert [float(value) for value in values[:-1]] == figures[::-1]
    assert values[-1] == "skipped: it was cut short"
    assert titles.nth(2).get_attribute("aria-sort") == "ascending"


def test_digits_in_groups_are_sorted_as_numbers(opened, report, poses):
    volumes = [15013.0, 999.0, 2400.0, 1234567.0]
    frames = tuple(
        replace(frame, volume=volumes[frame.index % 4], name=f"{frame.index}.obj")
        for frame in report.frames
        if frame.skipped is None
    )
    page = opened(render_page(replace(report, frames=frames), poses)).page
    page.get_by_role("button", name="Volume", exact=True).click()
    titles = page.locator("#frames-table thead th").all_text_contents()
    values = _column(page, "frames-table", titles.index("Volume") + 1)
    assert list(dict.fromkeys(values)) == [
        "1.23457e+06",
        "15\u202f013",
        "2\u202f400",
        "999",
    ]


def test_the_keyboard_sorts_the_frames_by_name_as_numbers(opened, html, report):
    page = opened(html).page
    page.get_by_role("button", name="Frame", exact=True).focus()
    page.keyboard.press("Enter")
    names = [frame.name for frame in report.frames]
    assert _column(page, "frames-table", 2) == names
    page.keyboard.press("Space")
    assert _column(page, "frames-table", 2) == names[::-1]


@pytest.mark.parametrize("frame", [0, 3, 17, 33])
def test_the_cursor_shows_the_frame_under_the_mouse(opened, html, report, frame):
    page = opened(html).page
    page.mouse.move(*_frame_position(page, frame))
    assert _cursor_values(page) == _expected(report.frames[frame])
    assert format_percent(report.frames[frame].rms_percent) in page.text_content("#status")
    page.mouse.move(0, 0)
    assert page.locator("#plot .tip").is_hidden()


def test_the_cursor_shows_the_right_frame_in_a_sorted_table(opened, html, report):
    page = opened(html).page
    page.get_by_role("button", name="Max deviation, %", exact=True).click()
    page.mouse.move(*_frame_position(page, 7))
    assert _cursor_values(page) == _expected(report.frames[7])


def test_the_cursor_is_at_the_frame_of_the_plot(opened, html):
    page = opened(html).page
    page.mouse.move(*_frame_position(page, 11))
    box = page.locator("#plot .cursor").bounding_box()
    assert abs(box["x"] + box["width"] / 2 - _frame_position(page, 11)[0]) < 2


def test_the_keyboard_moves_the_cursor(opened, html, report):
    page = opened(html).page
    page.locator("#plot").focus()
    worst, last = report.summary.worst_frame_index, len(report.frames) - 1
    assert _cursor_values(page) == _expected(report.frames[worst])
    steps = [("Home", 0), ("ArrowLeft", 0), ("ArrowRight", 1), ("PageUp", 11), ("PageDown", 1)]
    for key, frame in steps:
        page.keyboard.press(key)
        assert _cursor_values(page) == _expected(report.frames[frame])
        name = report.frames[frame].name
        assert page.text_content("#status").startswith(
            f"frame {report.frames[frame].number}, {name}: rms, % "
        )
        assert page.get_attribute("#plot", "aria-valuenow") == str(frame)
        assert page.get_attribute("#plot", "aria-valuetext") == name
    page.keyboard.press("End")
    assert _cursor_values(page) == (report.frames[last].name, [["skipped: it was cut short"]])


def test_an_open_model_and_one_without_pictures_work_too(opened, report):
    frames = tuple(
        replace(
            frame, volume=None, volume_reconstructed=None, volume_change=None, volume_drift=None
        )
        for frame in report.frames
    )
    summary = replace(report.summary, volume_change_percent_max=None, volume_change_frame=None)
    clip = replace(report.clip, closed=False)
    page = opened(
        render_page(replace(report, frames=frames, summary=summary, clip=clip), None)
    ).page
    page.mouse.move(*_frame_position(page, 4))
    assert _cursor_values(page)[1] == _expected(report.frames[4])[1][:2]


def test_a_clip_of_one_frame_works(opened, report):
    frames, summary = report.frames[:1], replace(report.summary, worst_frame_index=0)
    page = opened(render_page(replace(report, frames=frames, summary=summary), None)).page
    page.locator("#plot").focus()
    page.keyboard.press("ArrowRight")
    assert _cursor_values(page) == _expected(report.frames[0])


@pytest.mark.parametrize("kind", ["page", "index"])
@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_nothing_is_wider_than_the_window(opened, html, index, kind, width, scheme):
    page = opened(
        html if kind == "page" else index,
        viewport={"width": width, "height": 800},
        color_scheme=scheme,
    ).page
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")


def test_all_columns_of_an_index_are_in_the_window(opened, index):
    page = opened(index, viewport={"width": 1280, "height": 800}).page
    assert page.eval_on_selector(".most", "one => one.scrollWidth <= one.clientWidth")


@pytest.mark.parametrize("width", WIDTHS)
def test_the_reason_of_a_failure_stays_in_the_window(opened, report, width):
    fault = "/srv/walks/broken/mesh_0020.obj: line 5180: 1 coordinates; " + 20 * "export it again "
    entries = [build_clip_entry(report, page="clip.html"), ClipEntry("walks/broken", fault=fault)]
    page = opened(render_index(Overview(entries)), viewport={"width": width, "height": 800}).page
    page.eval_on_selector(".most", "one => { one.scrollLeft = 160; }")
    window = page.locator(".most").bounding_box()
    sentence = page.locator(".sentence > div").bounding_box()
    assert window["x"] <= sentence["x"]
    assert sentence["x"] + sentence["width"] <= window["x"] + window["width"]


@pytest.mark.parametrize("width", WIDTHS)
def test_the_navigation_shows_all_sections_in_one_row_of_a_laptop(opened, html, width):
    page = opened(html, viewport={"width": width, "height": 800}).page
    boxes = [link.bounding_box() for link in page.locator(".contents a").all()]
    assert all(box["x"] >= 0 and box["x"] + box["width"] <= width for box in boxes)
    assert len({box["y"] for box in boxes}) == 1 or width < 1024


def test_the_text_for_a_message_is_copied(opened, html):
    page = opened(html).page
    page.get_by_text("Text for a message").click()
    page.get_by_role("button", name="Copy").click()
    assert page.text_content("#status") == "Copied"
    assert page.evaluate("getSelection().toString()").strip() == page.text_content("#message")


def test_links_to_sections_show_their_headings(opened, html):
    page = opened(html, reduced_motion="reduce").page
    for link in page.locator(".contents a").all():
        link.click()
        bar = page.locator(".contents").bounding_box()
        heading = page.locator(link.get_attribute("href") + " h2").bounding_box()
        assert bar["y"] + bar["height"] < heading["y"] < 900


@pytest.mark.parametrize("kind", ["page", "index"])
def test_long_names_are_wrapped(opened, report, poses, kind):
    long = 300 * "x"
    summary = replace(
        report.summary, worst_frame=long, max_deviation_frame=long, volume_change_frame=long
    )
    named = replace(
        report,
        result=long,
        summary=summary,
        notes=(Note(long),),
        settings={long: long},
        sources={long: {"name": long, long: long}},
        gates=tuple(replace(gate, frame=long) for gate in report.gates),
        frames=tuple(replace(frame, name=long) for frame in report.frames),
    )
    entries = [build_clip_entry(named, page="a.html"), ClipEntry(long, fault=long)]
    html = render_page(named, poses) if kind == "page" else render_index(Overview(entries))
    page = opened(html, viewport={"width": 360, "height": 800}).page
    if kind == "page":
        page.locator("#plot").focus()
        page.keyboard.press("End")
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")


LUMINANCE = """element => {
  const [r, g, b] = getComputedStyle(element).backgroundColor.match(/[\\d.]+/g).map(Number);
  return (0.2126 * r + 0.7152 * g + 0.0722 * b) / 255;
}"""


@pytest.mark.parametrize("kind", ["page", "index"])
def test_dark_mode_is_dark_and_print_is_white(opened, html, index, kind):
    page = opened(html if kind == "page" else index, color_scheme="dark").page
    assert page.eval_on_selector("body", LUMINANCE) < 0.1
    page.emulate_media(media="print")
    assert page.eval_on_selector("body", LUMINANCE) > 0.99
    assert page.eval_on_selector(".card", LUMINANCE) > 0.99
    page.emulate_media(media="screen", color_scheme="light")
    assert page.eval_on_selector("body", LUMINANCE) > 0.9


def test_print_has_every_frame_and_no_controls(opened, html):
    page = opened(html).page
    page.emulate_media(media="print")
    assert page.locator("nav").is_hidden()
    table = page.locator("#frames .wide")
    assert table.evaluate("one => one.scrollHeight <= one.clientHeight + 1")
    assert page.pdf().startswith(b"%PDF")


def test_pictures_are_drawn(opened, html):
    page = opened(html).page
    images = page.locator("img").all()
    assert len(images) >= 14  # four poses, three views each, and two of the spread
    for image in images:
        image.scroll_into_view_if_needed()
        page.wait_for_function("image => image.naturalWidth > 0", arg=image.element_handle())


def test_a_pose_can_be_enlarged(opened, html):
    page = opened(html).page
    picture = page.locator(".pose img").nth(4)
    small = picture.bounding_box()["width"]
    button = page.get_by_role("button", name="Larger pictures of the worst frame")
    button.focus()
    page.keyboard.press("Enter")
    assert button.get_attribute("aria-pressed") == "true"
    assert picture.bounding_box()["width"] > 1.8 * small
    button.click()
    assert picture.bounding_box()["width"] == small


def test_hostile_names_do_nothing(opened, report, poses):
    page = opened(render_page(with_hostile_names(report), poses)).page
    page.mouse.move(*_frame_position(page, 1))
    page.locator("#plot").focus()
    for _ in NAMES:
        page.keyboard.press("ArrowRight")
    page.get_by_role("button", name="Frame", exact=True).click()
    assert page.evaluate("window.struck") is None
    assert page.locator("#plot .tip b script").count() == 0


def test_hostile_names_do_nothing_among_clips(opened, report):
    hostile = build_clip_entry(with_hostile_names(report), page=NAMES[-1])
    entries = [replace(hostile, name=name) for name in NAMES]
    page = opened(render_index(Overview([*entries, *(ClipEntry(n, fault=n) for n in NAMES)]))).page
    page.get_by_role("button", name="Clip", exact=True).click()
    page.get_by_label("Filter by name").fill("<script>")
    hrefs = page.eval_on_selector_all("th a", "links => links.map(link => link.protocol)")
    assert set(hrefs) == {"file:"}
    assert page.evaluate("window.struck") is None


def test_an_injected_script_does_not_run(browser, tmp_path, html):
    """Test of the policy: the page gets a script on purpose."""
    path = tmp_path / "spoilt.html"
    spoilt = "<script>window.struck = 1</script><img src='x' onerror='window.struck = 1'>"
    path.write_text(html.replace('<main id="main">', '<main id="main">' + spoilt))
    page = browser.new_page()
    said = []
    page.on("console", lambda message: said.append(message.text))
    page.goto(path.as_uri())
    assert page.evaluate("window.struck") is None
    assert any("Content Security Policy" in text for text in said)
    page.close()


def test_clips_are_sorted_and_failed_ones_stay_on_top(opened, index):
    page = opened(index).page
    assert _column(page, "clips", 4) == sorted(_column(page, "clips", 4), key=float, reverse=True)
    button = page.get_by_role("button", name="Error, %", exact=True)
    button.focus()
    page.keyboard.press("Enter")
    page.keyboard.press("Enter")
    assert _column(page, "clips", 4) == sorted(_column(page, "clips", 4), key=float)
    page.get_by_role("button", name="Clip", exact=True).click()
    assert _column(page, "clips", 1) == [f"shot_{k}" for k in range(12)]
    assert page.text_content("#clips tbody tr th") == "walks/broken"


def test_clips_are_filtered_by_parts_of_their_names(opened, index):
    page = opened(index).page
    page.get_by_label("Filter by name").fill("1 Shot_")
    shown = page.locator("#clips tbody tr:visible th").all_text_contents()
    assert sorted(shown) == ["shot_1", "shot_10", "shot_11"]
    assert page.text_content("#status") == "3 of 13 shown"
    page.get_by_label("Filter by name").fill("")
    assert page.locator("#clips tbody tr:visible").count() == 13


def test_two_thousand_frames_can_be_sorted(opened, report, poses):
    frames = tuple(
        replace(report.frames[k % 30], index=k, number=1 + k, name=f"take_{k}.obj")
        for k in range(2000)
    )
    page = opened(render_page(replace(report, frames=frames), poses)).page
    page.get_by_role("button", name="RMS, %", exact=True).click()
    figures = [float(text) for text in _column(page, "frames-table", 3)]
    assert all(a >= b for a, b in pairwise(figures))
    page.locator("#plot").focus()
    page.keyboard.press("End")
    assert _cursor_values(page)[0] == "take_1999.obj"


def test_five_hundred_clips_load_in_time(opened, report):
    page = opened(render_index(Overview(make_500_clips(report)))).page
    taken = page.evaluate(
        "() => new Promise(done => requestAnimationFrame(() => setTimeout("
        "() => done(performance.getEntriesByType('navigation')[0].loadEventEnd))))"
    )
    print(f"500 clips: {taken:.0f} ms")
    assert 0 < taken < OPEN_IN
