"""The index page: worst first, every number as printed, no fetches."""

from dataclasses import replace
from decimal import Decimal
from urllib.parse import unquote

import pytest

from cageik_cli.report.figures import format_change, format_percent
from cageik_cli.report.html.index import render_index
from cageik_cli.report.limits import Limit, Limits, check_limits
from cageik_cli.report.overview import ClipEntry, Overview, build_clip_entry
from cageik_cli.report.record import build_report
from tests.report.clips import change, make_500_clips
from tests.report.hostile import NAMES, with_hostile_names
from tests.report.markup import find_faults, parse_page

FAULT = "frame_3.obj: line 7: `v 0.5` has 1 coordinate, expected 3; export it again"


def _show(*entries):
    return render_index(Overview(entries))


def _rows(page):
    return [row for body in parse_page(page).all("tbody") for row in body.all("tr")]


def _names(page):
    return [next(row.all("th")).text for row in _rows(page)]


def _with_limit(report, most="0.0001"):
    limits = Limits((Limit("rms", Decimal(most)),))
    return replace(report, gates=check_limits(report.result, report.summary, limits))


def test_failed_clips_come_first_then_those_over_a_limit_then_the_worst(report):
    report = replace(report, quality="fair")
    fine, over = build_clip_entry(report), build_clip_entry(_with_limit(report))
    page = _show(
        change(build_clip_entry(replace(report, quality="poor")), "poor", rms_percent=0.05),
        change(fine, "small", rms_percent=0.1),
        change(fine, "large", rms_percent=2.0),
        change(over, "over, small", rms_percent=0.2),
        change(over, "over, large", rms_percent=0.3),
        ClipEntry("broken", fault=FAULT),
    )
    assert _names(page) == ["broken", "over, large", "over, small", "poor", "large", "small"]
    assert _rows(page)[0].text.endswith(FAULT)
    assert (
        "1 of 6 clips failed, 2 of 6 clips over a limit, 1 of 6 clips poor" in parse_page(page).text
    )
    assert "Failed 1 Over a limit 2 Poor 1 OK 2" in parse_page(page).text


def test_a_row_has_the_picture_of_its_clip(report):
    drawn = build_clip_entry(report, picture=b"some PNG")
    page = parse_page(_show(drawn, change(build_clip_entry(report), "bare")))
    (picture,) = page.all("img")
    assert picture.attributes["src"].startswith("data:image/png;base64,")
    assert "Pictures: the worst frame" in page.text
    assert "Pictures" not in parse_page(_show(build_clip_entry(report))).text


@pytest.mark.parametrize(
    ("most", "quality", "verdict", "colour"),
    [
        ("99", "fair", "All clips done, none over a limit, none poor", "good"),
        ("99", "poor", "1 of 1 clip poor", "warn"),
        ("0.0001", "fair", "1 of 1 clip over a limit", "bad"),
    ],
)
def test_the_verdict_of_a_batch_follows_the_limits_and_the_quality(
    report, most, quality, verdict, colour
):
    report = replace(_with_limit(report, most), quality=quality, better="--fit")
    page = parse_page(_show(build_clip_entry(report)))
    assert verdict in page.text
    badges = [
        badge.attributes["class"]
        for badge in page.all("span")
        if "badge" in badge.attributes.get("class", "")
    ]
    assert badges == [f"badge {colour}"] * 2
    assert ("poor: cages.h5; better: --fit" in page.text) == (quality == "poor")


def test_a_row_shows_the_metrics_as_printed(report):
    over = build_clip_entry(replace(_with_limit(report), quality="fair"))
    (row,) = _rows(_show(over))
    summary, cells = report.summary, [cell.text for cell in row.all("td")]
    rms = format_percent(summary.rms_percent)
    assert cells == [
        f"Fair, over the limit RMS error of the clip {rms} > 0.0001 %",
        "",
        rms,
        f"{format_percent(summary.worst_frame_rms_percent)} {summary.worst_frame}",
        format_percent(summary.max_deviation_percent),
        format_change(summary.volume_change_percent_max),
        "5",
        "18",
        "8",
    ]


def test_an_open_model_has_no_volume_change(opened):
    (row,) = _rows(_show(build_clip_entry(build_report(opened.result))))
    assert [cell.text for cell in row.all("td")][5] == "open"
    (svg,) = (svg for svg in row.all("svg") if svg.attributes.get("class") == "thumb")
    assert "max deviation up to" in svg.attributes["aria-label"]


@pytest.mark.parametrize(
    ("figure", "value", "cell", "shown"),
    [
        ("frames_skipped", 2, 6, "5 2 skipped"),
        ("volume_change_percent_max", None, 5, "unknown"),  # closed, with missing data
    ],
)
def test_what_a_clip_lacks_is_said(report, figure, value, cell, shown):
    (row,) = _rows(_show(change(build_clip_entry(report), **{figure: value})))
    assert [cell.text for cell in row.all("td")][cell] == shown


def _paths(page):
    (svg,) = (s for s in parse_page(page).all("svg") if s.attributes.get("class") == "thumb")
    return {path.attributes["class"]: path.attributes["d"] for path in svg.all("path")}


def test_a_thumbnail_is_the_curve(report):
    entry = build_clip_entry(report)
    curve = replace(
        entry.curve,
        rms_percent=(0.0, 1.0, None, 2.0, None, 1.0, 0.5),
        other=(0.0, -1.0, 1.0, None, None, 0.0, 0.0),
        worst=3,
    )
    paths = _paths(_show(replace(entry, curve=curve)))
    # From 4, the largest value, to 44, zero or the smallest; two units a point; gaps; lone points.
    assert paths["rms"] == "M0 44 2 24M6 4h0M10 24 12 34"
    assert paths["other"] == "M0 24 2 44 4 4M10 24 12 24"
    assert paths["worst"] == "M6 4h0"


def test_a_thumbnail_of_nothing_but_zeros_is_flat(report):
    entry = build_clip_entry(report)
    curve = replace(entry.curve, rms_percent=(0.0, 0.0), other=(None, None), worst=0)
    paths = _paths(_show(replace(entry, curve=curve)))
    assert (paths["rms"], paths["other"]) == ("M0 4 2 4", "")


@pytest.mark.parametrize(
    "page", ["a/b c.html", "javascript:x.html", "a%20b#c?d.html", "ü/“.html", "a/\udce9.html"]
)
def test_links_are_relative_and_quoted(report, page):
    (row,) = _rows(_show(build_clip_entry(report, page=page)))
    (link,) = row.all("a")
    href = link.attributes["href"]
    assert unquote(href, errors="surrogateescape") == f"./{page}"
    assert not set(href) & set(' #?:"<>')
    assert href.isascii()


def test_a_clip_without_a_page_has_no_link(report):
    (row,) = _rows(_show(build_clip_entry(report)))
    assert list(row.all("a")) == []


def test_the_page_fetches_nothing_and_is_accessible(report):
    done = [build_clip_entry(report, page="a.html"), build_clip_entry(_with_limit(report))]
    failed = [ClipEntry("broken", fault=FAULT)]
    for clips in (failed, done, failed + done):
        page = _show(*clips)
        assert find_faults(page) == []
        assert page == _show(*clips)


def test_hostile_names_are_shown_as_text(report):
    hostile = build_clip_entry(with_hostile_names(report), page=NAMES[3])
    entries = [replace(hostile, name=name) for name in NAMES]
    entries += [ClipEntry(name, fault=name) for name in NAMES]
    page = _show(*entries)
    assert find_faults(page) == []
    assert len(list(parse_page(page).all("script"))) == 1
    shown = [" ".join(name.split()) for name in NAMES]
    assert sorted(_names(page)) == sorted(2 * shown)


def test_five_hundred_clips_are_a_small_file(report):
    assert len(_show(*make_500_clips(report)).encode()) < 2_000_000
