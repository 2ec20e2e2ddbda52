"""The page of a result: numbers as printed, no empty columns, no fetches, accessible."""

import hashlib
import re
from dataclasses import fields, replace
from decimal import Decimal

import numpy as np
import pytest

from cageik_cli.report.figures import (
    FrameRecord,
    KeptSummary,
    format_change,
    format_length,
    format_metric,
    format_percent,
    format_scene_length,
)
from cageik_cli.report.html import pictures
from cageik_cli.report.html.page import (
    FRAME_COLUMNS,
    build_quality_rows,
    choose_columns,
    compute_record_digest,
    format_cells,
    is_page_current,
    render_page,
)
from cageik_cli.report.limits import (
    Limit,
    LimitCheck,
    Limits,
    check_limits,
    make_overall_verdict,
)
from cageik_cli.report.record import build_report
from cageik_cli.report.render.shading import COLOUR_SCALE
from cageik_cli.report.views.data import format_json
from cageik_cli.report.views.front import format_front
from cageik_cli.report.views.text import format_text
from cageik_cli.util.messages import Note
from tests.report.hostile import NAMES, with_hostile_names
from tests.report.markup import find_faults, parse_page

LIMITS = Limits(
    (
        Limit("rms", Decimal("0.0001")),
        Limit("max_deviation", Decimal("9.5"), "units"),
        Limit("volume_change", Decimal("99")),
    )
)


@pytest.fixture(scope="module")
def report(closed):
    return build_report(closed.result, LIMITS)


@pytest.fixture(scope="module")
def drawn(poses):
    """Poses whose scales end at 1.5 and 0.8 percent, the last of a hostile name; no region."""
    shown = [replace(pose, deviation=np.full(18, 1.1)) for pose in poses.poses]
    shown[-1] = replace(shown[-1], name=NAMES[0])
    return replace(poses, poses=tuple(shown), vertex_rms=np.full(18, 0.7), region=None)


@pytest.fixture(scope="module")
def page(report, drawn):
    return render_page(report, drawn, pixels=8)


def test_the_verdict_and_the_error_come_first(page, report):
    main, clip = parse_page(page).by_id("main").text, report.clip
    rms = report.summary.rms_percent
    length, size = format_scene_length(clip, rms), format_scene_length(clip, 100, 3)
    assert main.startswith(
        f"Verdict {report.quality.capitalize()} Over 1 of 3 limits {format_percent(rms)} % of the "
        f"diagonal {length} of {size} on average"
    )


@pytest.mark.parametrize("quality", ["good", "fair", "poor", None])
def test_the_quality_is_a_badge_unless_nothing_was_judged(report, quality):
    shown = parse_page(render_page(replace(report, quality=quality, gates=()))).by_id("verdict")
    badges = [one for one in shown.all("span") if "badge" in one.attributes.get("class", "")]
    assert [badge.text for badge in badges] == ([quality.capitalize()] if quality else [])


def test_five_figures_are_seen_and_published_metrics_are_folded(page):
    verdict = parse_page(page).by_id("verdict")
    folded, message = verdict.all("details")
    names = [[name.text for name in part.all("dt")] for part in (verdict, folded)]
    own = [name for name in names[0] if name not in names[1]]
    assert own[:5] == [
        "Worst frame", "Max deviation", "Error by area", "Largest volume change", "Size"
    ]  # fmt: skip
    assert own[5:] == ["Look at", "Better"]
    assert names[1] == ["Error by radius", "E_RMS", "KG error"]
    assert list(message.all("dt")) == []


def test_an_exact_result_has_no_advice(report):
    """A list without entries would be a fault of the page."""
    exact = replace(report.summary, rms_percent=2e-14, max_deviation_percent=3e-13)
    page = render_page(replace(report, summary=exact, better=None))
    assert find_faults(page) == []
    assert "advice" not in [one.attributes.get("class") for one in parse_page(page).all("dl")]


def test_the_text_for_a_message_is_that_of_the_command_line(page, report):
    (text,) = parse_page(page).all("pre")
    front = format_front(report, source="the page")
    assert text.text.split() == front.split()
    assert "the page shows" in text.text


def test_of_captured_data_what_was_kept_is_judged_and_shown(report):
    """Thrown vertices have an error of 40 %, which is in no figure at the top."""
    kept = KeptSummary(0.25, 1.5, 2.0, 4, "a", 1.25, 3, "b")
    frames = tuple(
        replace(frame, rms_kept_percent=0.5, max_deviation_kept_percent=1.5, rms_percent=40.0)
        for frame in report.frames
    )
    shown = replace(report, kept=kept, frames=frames, quality="good", gates=())
    text = parse_page(render_page(shown)).by_id("verdict").text
    assert text.startswith("Verdict Good 0.2500 % of the diagonal")
    assert "Worst frame 0.5000 %" in text
    assert "Max deviation 1.5000 %" in text
    assert f"Over all data: {format_percent(report.summary.rms_percent)} %" in text
    assert "40.0000" not in text


def test_each_limit_has_its_row(page, report):
    summary = report.summary
    table = next(parse_page(page).by_id("verdict").all("table"))
    rms, change = (
        format_percent(value)
        for value in (summary.rms_percent, abs(summary.volume_change_percent_max))
    )
    largest, moved = format_length(summary.max_deviation), summary.max_deviation_frame
    assert table.rows[1:] == [
        ["RMS error of the clip", "0.0001", rms, "% of the diagonal", summary.worst_frame,
         "over limit"],
        ["max deviation", "9.5", largest, "file units", moved, "within limit"],
        ["volume change", "99", change, "% of the volume", summary.volume_change_frame,
         "within limit"],
    ]  # fmt: skip


def test_limits_of_a_baseline_show_their_baseline(report):
    gates = tuple(replace(gate, baseline=0.25) for gate in report.gates[:1]) + report.gates[1:]
    table = next(
        parse_page(render_page(replace(report, gates=gates))).by_id("verdict").all("table")
    )
    names = [row.text for row in table.all("th") if row.attributes["scope"] == "row"]
    assert names[0] == "RMS error of the clip baseline 0.2500"
    assert not any("baseline" in name for name in names[1:])


def test_without_limits_the_verdict_says_so(report):
    verdict = parse_page(render_page(replace(report, gates=()))).by_id("verdict")
    assert "No limits set" in verdict.text
    assert list(verdict.all("table")) == []


GATE = LimitCheck("rms", "%", 1.0, 0.5, "a", True)
OVER, UNCHECKED = replace(GATE, passed=False), replace(GATE, found=None, passed=None)


@pytest.mark.parametrize(
    ("gates", "state", "text"),
    [
        ([], "none", "No limits set"),
        ([GATE], "good", "Within the limit"),
        ([OVER], "bad", "Over the limit"),
        ([UNCHECKED], "none", "No limit could be checked"),
        ([GATE, GATE], "good", "Within 2 of 2 limits"),
        ([GATE, UNCHECKED], "good", "Within 1 of 2 limits; 1 could not be checked"),
        ([GATE, OVER, UNCHECKED], "bad", "Over 1 of 3 limits; 1 could not be checked"),
    ],
)
def test_the_verdict_counts_the_limits(gates, state, text):
    assert make_overall_verdict(gates) == (state, text)


def test_every_number_of_the_record_is_on_the_page(page, report):
    words = parse_page(page).text
    summary, vertices, binding = report.summary, report.vertices, report.binding
    printed = [
        *map(format_percent, (summary.rms_percent, summary.worst_frame_rms_percent)),
        format_percent(summary.max_deviation_percent),
        *map(format_length, (summary.rms, summary.worst_frame_rms, summary.max_deviation)),
        *map(format_change, (summary.volume_change_percent_max, summary.volume_drift_percent_max)),
        *map(format_metric, (summary.e_rms, summary.kg_error)),
        *map(str, (summary.max_deviation_vertex, summary.floats_per_frame)),
        f"{report.clip.vertices} x {report.clip.cage_vertices} weight matrix",
        *map(format_percent, vertices.edges_percent),
        *map(str, vertices.counts),
        f"{binding.partition_of_unity:.1e}",
        f"{binding.linear_precision:.1e}",
        f"{binding.min_weight:.1e}",
        f"{binding.estimated_error:.1e}",
        f"{binding.condition_number:.4g}",
        *map(str, (binding.panels, binding.projected)),
        *map(str, (report.clip.frames, report.clip.vertices, report.clip.cage_vertices)),
        format_length(report.clip.diagonal),
        *(str(value) for value in report.settings.values() if not isinstance(value, bool)),
        *(source["sha256"] for source in report.sources.values() if "sha256" in source),
        compute_record_digest(report),
    ]
    for vertex in vertices.worst:
        printed += [str(vertex["vertex"]), format_percent(vertex["rms_percent"])]
        printed += map(format_length, (vertex["rms"], *vertex["position"]))
    missing = [text for text in printed if not re.search(rf"(?<!\w){re.escape(text)}(?!\w)", words)]
    assert missing == []


def test_the_table_of_frames_shows_the_record(page, report):
    titles, *rows = parse_page(page).by_id("frames-table").rows
    assert titles[:4] == ["#", "Frame", "RMS, %", "RMS, file units"]
    columns = choose_columns(report)
    assert rows == [format_cells(frame, columns) for frame in report.frames]


def test_the_page_shows_all_numbers_of_the_text(page, report):
    """But for the best possible error."""
    words, rows = parse_page(page).text, format_text(report).splitlines()
    text = "\n".join(row for row in rows if not row.startswith("  best possible"))
    figures = re.findall(r"[-+]?\d+\.\d{4}\b|\b\d\.\de-\d\d\b", text)
    assert len(figures) > 6
    assert [figure for figure in figures if figure not in words] == []


def test_an_open_model_has_no_volume(opened):
    page = render_page(build_report(opened.result, LIMITS))
    assert "Volume change not defined the model is open" in parse_page(page).by_id("verdict").text
    assert "volume change 99 not defined % of the volume not checked" in parse_page(page).text
    assert "the model is open" in parse_page(page).by_id("notes").text
    assert find_faults(page) == []


def test_figures_that_are_not_defined_say_so(report):
    names = ("volume_change_percent_max", "volume_change_frame", "kg_error")
    none = replace(report.summary, **dict.fromkeys(names), volume_drift_percent_max=None)
    words = parse_page(render_page(replace(report, summary=none))).by_id("verdict").text
    assert "Volume change not defined some vertices are missing data" in words
    assert "KG error not defined" in words
    summary = replace(report.summary, volume_drift_percent_max=None)
    words = parse_page(render_page(replace(report, summary=summary))).by_id("verdict").text
    assert "drift of the input from rest not defined" in words


def test_skipped_frames_show_their_reason(report):
    frames = (*report.frames[:-1], with_hostile_names(report).frames[-1])
    skipping = replace(
        report, frames=frames, summary=replace(report.summary, frames_skipped=1), gates=()
    )
    page = render_page(skipping)
    assert find_faults(page) == []
    assert parse_page(page).by_id("frames-table").rows[-1][2] == f"skipped: {NAMES[1]}"
    assert "1 of 5 frames skipped" in parse_page(page).text


def test_the_quality_of_weights_is_explained(page, report):
    text = parse_page(page).by_id("weights").text
    for row in build_quality_rows(report):
        assert " ".join(row).strip() in text


def test_the_page_has_all_pictures_and_their_scales(page, poses):
    tree = parse_page(page)
    alts = [image.attributes["alt"] for image in tree.all("img")]
    assert len(alts) == len(set(alts)) == 1 + 4 * 3 + 2
    titles = [title.text for title in tree.by_id("poses").all("h3")]
    assert titles == [
        "Rest pose",
        f"Worst frame {poses.poses[1].name}",
        f"Median frame {poses.poses[2].name}",
        f"Best frame {NAMES[0]}",
    ]
    assert "0 0.375 0.75 1.125 1.5" in tree.by_id("poses").text
    assert "0 0.2 0.4 0.6 0.8" in tree.by_id("worst-vertices").text
    ramps = [e for e in tree.all("div") if e.attributes.get("class") == "ramp"]
    assert len(ramps) == 2
    assert all(", ".join(COLOUR_SCALE) in ramp.attributes["style"] for ramp in ramps)


def test_a_page_without_pictures_says_why(report):
    page = render_page(report)
    assert "--no-weights" in parse_page(page).by_id("poses").text
    assert len(list(parse_page(page).all("img"))) == 1


def test_the_bars_of_the_histogram_are_the_counts(page, report):
    (svg,) = (
        svg
        for svg in parse_page(page).by_id("histogram").all("svg")
        if svg.attributes["role"] == "img"
    )
    bars = [bar for bar in svg.all("rect") if bar.attributes["class"] == "bar"]
    heights = np.array([float(bar.attributes["height"]) for bar in bars])
    counts = np.array(report.vertices.counts)
    np.testing.assert_allclose(heights, 100 * counts / counts.max(), rtol=0, atol=0.005)
    assert str(counts.max()) in svg.attributes["aria-label"]


@pytest.mark.parametrize(("top", "shown"), [(3.0, "3.0000"), (3e-14, "3e-14")])
def test_the_bins_of_the_histogram_have_different_labels(report, top, shown):
    edges = tuple(np.linspace(0, top, len(report.vertices.counts) + 1).tolist())
    vertices = replace(report.vertices, edges_percent=edges)
    spread = parse_page(render_page(replace(report, vertices=vertices))).by_id("histogram")
    rows = [[cell.text for cell in row.all("td")] for row in spread.all("tr")][1:]
    assert rows[-1][1] == shown
    assert len({low for low, _, _ in rows}) == len(rows)


def test_the_plot_has_the_position_of_its_axes(page, report):
    plot = parse_page(page).by_id("plot").attributes
    left, right, top, bottom = (
        float(plot[f"data-{side}"]) for side in ("left", "right", "top", "bottom")
    )
    assert 0 < left < right < 1
    assert 0 < top < bottom < 1
    assert float(plot["data-first"]) < 0 < len(report.frames) - 1 < float(plot["data-last"])


def test_the_page_fetches_nothing_and_is_accessible(page):
    assert find_faults(page) == []
    order = [section.attributes["id"] for section in parse_page(page).by_id("main").all("section")
             if "id" in section.attributes]  # fmt: skip
    links = [link.attributes["href"][1:] for link in next(parse_page(page).all("nav")).all("a")]
    assert order == links
    assert order[0] == "verdict"


def test_the_same_report_gives_the_same_bytes(page, report, drawn):
    assert render_page(report, drawn, pixels=8) == page


def test_hostile_names_are_shown_as_text(report, drawn):
    hostile = with_hostile_names(report)
    page = render_page(hostile, drawn, pixels=8)
    assert find_faults(page) == []
    assert len(list(parse_page(page).all("script"))) == 1
    assert not {element.tag for element in parse_page(page).all()} & {"b", "iframe", "object"}
    shown = [" ".join(frame.name.split()) for frame in hostile.frames]
    assert [row[1] for row in parse_page(page).by_id("frames-table").rows[1:]] == shown


def test_two_thousand_frames_with_pictures_are_under_5_mb(report, drawn, monkeypatch):
    """The pictures are as large as those of a character of 10 000 vertices."""
    large = np.random.default_rng(1).bytes(100_000)
    monkeypatch.setattr(pictures, "encode_png", lambda picture: large)
    frames = [
        replace(report.frames[k % 5], index=k, number=1 + k, name=f"sequence_take_07_{k:06d}.obj")
        for k in range(2000)
    ]
    page = render_page(replace(report, frames=tuple(frames)), drawn, pixels=8)
    assert 1_800_000 < len(page.encode()) < 5_000_000


def test_a_page_is_current_only_for_its_report(tmp_path, page, report):
    path = tmp_path / "page.html"
    assert not is_page_current(path, report, True)
    path.write_text(page)
    assert is_page_current(path, report, True)
    assert not is_page_current(path, replace(report, notes=(Note("another"),)), True)
    assert not is_page_current(
        path, replace(report, gates=check_limits("", report.summary, Limits())), True
    )
    assert not is_page_current(path, report, False)
    assert not is_page_current(tmp_path, report, True)


def test_the_record_tag_is_in_the_head_for_any_name(tmp_path, report):
    path = tmp_path / "page.html"
    named = replace(report, result="x" * 10_000)
    path.write_text(render_page(named))
    assert is_page_current(path, named, False)
    expected = hashlib.sha256(format_json([named]).encode()).hexdigest()
    assert compute_record_digest(named) == expected


FIGURES = FrameRecord(
    index=3,
    number=1003,
    name="a",
    rms=0.0123456789,
    rms_percent=1.23456789,
    max_deviation=2e-7,
    max_deviation_percent=2e-5,
    worst_vertex=7,
    volume=None,
    volume_reconstructed=8.0,
    volume_change=0.5,
    volume_drift=-1.0,
    skipped=None,
)


KEPT = (
    *("missing", "rejected", "rms_kept_percent", "max_deviation_kept_percent"),
    *("area_rms_percent", "area_rms_kept_percent"),
)
VOLUMES = ("volume_change", "volume", "volume_reconstructed", "volume_drift")


def names_of(report):
    return [column.name for column in choose_columns(report)]


def test_every_metric_of_a_frame_has_a_column():
    names = [column.name for column in FRAME_COLUMNS]
    assert sorted([*names, "index", "skipped"]) == sorted(
        field.name for field in fields(FrameRecord)
    )


def test_cells_are_formatted_as_in_all_views():
    lengths = ["1.2346", "0.0123457", "2e-05", "2e-07", "7"]
    volumes = ["+0.5000", "", "8", "-1.0000"]
    assert format_cells(FIGURES, FRAME_COLUMNS) == ["1003", "a", *lengths, *[""] * 6, *volumes]


def test_a_column_without_values_is_left_out(report, opened):
    names = [column.name for column in FRAME_COLUMNS if column.name not in KEPT]
    assert names_of(report) == names
    assert names_of(build_report(opened.result)) == [name for name in names if name not in VOLUMES]


def test_one_frame_with_a_value_makes_a_column(report):
    first, *others = report.frames
    without = tuple(replace(frame, volume_drift=None) for frame in others)
    assert "volume_drift" in names_of(replace(report, frames=(first, *without)))
    assert "volume_drift" not in names_of(replace(report, frames=without))


@pytest.mark.parametrize(
    ("coordinates", "accuracy", "panels", "words"),
    [
        ("harmonic", "fine", 8, ["0.001 or less (`accuracy=fine`)", "never negative"]),
        ("mean-value", None, 0, ["closed form", "negative near concave parts"]),
        ("harmonic", "other", 8, ["never negative"]),
    ],
)
def test_weights_are_explained_by_their_kind(report, coordinates, accuracy, panels, words):
    settings = {"coordinates": coordinates, "accuracy": accuracy}
    binding = replace(report.binding, panels=panels)
    rows = build_quality_rows(replace(report, settings=settings, binding=binding))
    text = " ".join(f"{meaning} {expected}" for _, _, meaning, expected in rows)
    assert [word for word in words if word not in text] == []
    assert ("Panels" in [label for label, *_ in rows]) == bool(panels)
    assert ("accuracy=" in text) == (accuracy == "fine")


def test_counts_and_lengths_have_thin_groups_of_digits(report):
    clip = replace(report.clip, vertices=34159, cage_vertices=1200, diagonal=15013.2)
    frames = (replace(report.frames[0], volume=123456.0), *report.frames[1:])
    page = render_page(replace(report, clip=clip, frames=frames))
    assert "of 34\u202f159 vertices in a cage of 1\u202f200 " in page
    assert "diagonal 15\u202f013.2 " in page
    assert ">123\u202f456</td>" in page
