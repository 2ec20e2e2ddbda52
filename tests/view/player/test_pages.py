"""The player in a page, and alone: its data and script, under the same strict policy."""

import base64
import hashlib
import json
import re
from importlib.resources import files

import pytest

from cageik_cli.cages.bind import bind
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.report.html.page import render_page, render_result_page
from cageik_cli.report.vocabulary import EDIT_VOCABULARY
from cageik_cli.view.player import section
from cageik_cli.view.player.clip import make_single_pose
from cageik_cli.view.player.section import (
    PLAYER_SCRIPTS,
    REST_SCRIPTS,
    SERVED_SCRIPTS,
    build_player,
    render_rest_cage_page,
    render_view_page,
)
from tests.report.markup import find_faults, parse_page
from tests.shapes import ball, box
from tests.view.player.rebuild import unpack_payload

MAX_SCRIPT_BYTES = 136_000
"""Of a page, shortened; compressed they are a third."""


@pytest.fixture(scope="module")
def page(report, poses, clip):
    return render_page(report, poses, player=build_player(clip), pixels=8)


def test_the_player_follows_the_verdict(page):
    sections = list(parse_page(page).by_id("main").all("section"))
    assert [one.attributes["id"] for one in sections[:2]] == ["verdict", "player"]
    links = [link.attributes["href"] for link in next(parse_page(page).all("nav")).all("a")]
    assert links[:2] == ["#verdict", "#player"]


def test_the_page_has_no_faults(page):
    assert find_faults(page) == []


def test_only_one_script_runs_and_the_policy_names_it(page):
    data, script = parse_page(page).all("script")
    assert data.attributes == {"type": "application/octet-stream", "id": "player-data"}
    assert script.attributes == {}
    digest = base64.b64encode(hashlib.sha256(script.source.encode()).digest()).decode()
    policy = parse_page(page).policy
    assert f"script-src 'sha256-{digest}'" in policy
    assert policy.startswith("default-src 'none'; ")
    assert "connect-src" not in policy
    assert "fetch(" not in script.source
    assert "eval" not in re.sub(r"evaluate", "", policy)


def test_the_data_is_that_of_the_clip(page, clip):
    (data, _) = parse_page(page).all("script")
    header, arrays = unpack_payload(data.source)
    assert tuple(header["frames"]) == clip.frames
    assert arrays["weights"].shape == clip.binding.weights.T.shape


def measure_script(text):
    return len(list(parse_page(text).all("script"))[-1].source.encode())


def test_the_script_is_small(report, page):
    own = measure_script(page) - measure_script(render_page(report))
    assert 10_000 < own <= MAX_SCRIPT_BYTES


def list_without_tooltip(text):
    """List the controls of a page that do not say in a sentence what they do."""
    controls = re.findall(r"<(?:button|input|select)\b[^>]*>", text.split("<script")[0])
    assert len(controls) > 30
    return [one for one in controls if not re.search(r' title="[A-Z][^"]*[^".]\."', one)]


def test_every_control_has_a_tooltip(clip):
    cage = json.dumps({"vertices": [], "polygons": [], "most": 0})
    session = {"key": "0"}
    for page in (
        render_view_page(clip, "apply", session=session),
        render_rest_cage_page(clip, "apply", cage, session),
    ):
        whole = page[page.index('id="player"') :]
        keys = whole[whole.index("<dialog") : whole.index("</dialog>")]
        assert list_without_tooltip(whole[: whole.index("<dialog")]) == []
        assert re.findall(r"<button[^>]*>", keys) == ['<button title="Close this list (Escape).">']
    broken = whole[: whole.index("<dialog")].replace(
        ' title="Play or pause the clip (Space)."', ' title="Play"'
    )
    assert len(list_without_tooltip(broken)) == 1


def test_the_scripts_of_pages_of_view_are_small(report, clip):
    edited = json.dumps({"vertices": [], "polygons": [], "most": 0})
    common = measure_script(render_page(report))
    for view in (
        render_view_page(clip, "apply", session={"key": "0"}),
        render_rest_cage_page(clip, "apply", edited, {"key": "0"}),
    ):
        assert 10_000 < measure_script(view) - common <= MAX_SCRIPT_BYTES


def test_every_script_of_the_player_is_in_the_page(page):
    folder = files("cageik_cli.view") / "templates" / "player"
    names = {one.name.removesuffix(".js") for one in folder.iterdir()}
    assert names == {*PLAYER_SCRIPTS, *SERVED_SCRIPTS, *REST_SCRIPTS}


def test_the_same_result_gives_the_same_bytes(page, report, poses, clip):
    assert render_page(report, poses, player=build_player(clip), pixels=8) == page


def test_without_a_player_nothing_of_it_is_there(closed, report):
    page = render_result_page(closed.result, report)
    assert "player" not in page


def test_what_is_left_out_is_said(report, clip, monkeypatch):
    monkeypatch.setattr(section, "MAX_DRAWN_VERTICES", 10)
    page = parse_page(render_page(report, player=build_player(clip))).by_id("player").text
    drawn = len(section.choose_vertices(clip.binding.rest, clip.binding.cage)[0])
    assert f"The player draws {drawn} of 18 vertices" in page


@pytest.fixture(scope="module")
def model():
    binding = bind(ball(levels=1, size=0.9), box(2.0), BindSettings("mean-value"))
    return make_single_pose(binding, ["<b>.obj", "--cage", "cage.obj"])


def test_the_page_names_its_model(model):
    page = render_view_page(model)
    assert '<h1 class="title">&lt;b&gt;.obj</h1>' in page
    assert page.count("data-player>") == 1


def test_a_model_without_a_name_has_a_heading(model):
    assert '<h1 class="title">Model in its cage</h1>' in render_view_page(
        make_single_pose(model.binding)
    )


@pytest.mark.parametrize(("session", "allowed"), [(None, False), ({"key": "0"}, True)])
def test_only_a_page_that_is_served_may_send_anything(model, session, allowed):
    policy = parse_page(render_view_page(model, session=session)).policy
    assert ("; connect-src 'self'" in policy) == allowed
    assert policy.startswith("default-src 'none'; ")
    assert "unsafe-eval" not in policy


def test_handles_are_in_the_page_whatever_their_names(model):
    name = "</script><script>alert(1)</script><!-- & ]]> \\ "
    document = {"handles": [{"name": name, "vertex": 0, "pin": True}]}
    page = render_view_page(model, handles=json.dumps(document))
    (text,) = re.findall(r'id="player-handles">(.*?)</script>', page, re.DOTALL)
    assert json.loads(text) == document
    assert "alert(1)</script>" not in page


def test_the_words_of_an_edited_clip_are_of_motion(model):
    assert ">error over the clip<" in render_view_page(model)
    assert ">distance moved over the clip<" in render_view_page(model, words=EDIT_VOCABULARY)


def test_without_handles_there_is_no_place_for_them(model):
    assert '<script type="application/json"' not in render_view_page(model)
