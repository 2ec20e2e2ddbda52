"""The page with the player alone."""

import json
import re

import pytest

from cageik_cli.cages.bind import bind
from cageik_cli.coordinates.settings import BindSettings
from cageik_cli.report.player.clip import make_single_pose
from cageik_cli.report.player.section import render_view_page
from tests.report.markup import parse_page
from tests.shapes import ball, box


@pytest.fixture(scope="module")
def clip():
    binding = bind(ball(levels=1, size=0.9), box(2.0), BindSettings("mean-value"))
    return make_single_pose(binding, ["<b>.obj", "--cage", "cage.obj"])


def test_the_page_names_its_model(clip):
    page = render_view_page(clip)
    assert "<h1>&lt;b&gt;.obj</h1>" in page
    assert page.count("data-player>") == 1


def test_a_model_without_a_name_has_a_heading(clip):
    assert "<h1>Model in its cage</h1>" in render_view_page(make_single_pose(clip.binding))


@pytest.mark.parametrize(("apply_url", "allowed"), [("", False), ("apply", True)])
def test_only_a_page_that_applies_may_send_anything(clip, apply_url, allowed):
    policy = parse_page(render_view_page(clip, apply_url)).policy
    assert ("; connect-src 'self'" in policy) == allowed
    assert policy.startswith("default-src 'none'; ")
    assert "unsafe-eval" not in policy


def test_handles_are_in_the_page_whatever_their_names(clip):
    name = "</script><script>alert(1)</script><!-- & ]]> \\ "
    document = {"handles": [{"name": name, "vertex": 0, "pin": True}]}
    page = render_view_page(clip, handles=json.dumps(document))
    (text,) = re.findall(r'id="player-handles">(.*?)</script>', page, re.DOTALL)
    assert json.loads(text) == document
    assert "alert(1)</script>" not in page


def test_the_words_of_an_edited_clip_are_of_motion(clip):
    assert ">error over the clip<" in render_view_page(clip)
    assert ">distance moved over the clip<" in render_view_page(clip, edited_from="cages.h5")


def test_without_handles_there_is_no_place_for_them(clip):
    assert '<script type="application/json"' not in render_view_page(clip)
