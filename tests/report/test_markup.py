"""The checks of pages find the faults that they are for."""

import pytest

from tests.report.markup import find_faults

BROKEN = {
    "<h1>a</h1><h3>b</h3>": "h3 after h1",
    "<h2>a</h2>": "not one h1, before the others",
    "<h1>a</h1><h1>b</h1>": "not one h1, before the others",
    "<h1>a</h1><img src='data:,'>": "img without alt",
    "<h1>a</h1><svg><path d=''/></svg>": "svg without a text",
    "<h1>a</h1><input id='a'>": "input without a label",
    "<h1>a</h1><table><tr><td>1</td></tr></table>": "table without a caption",
    "<h1>a</h1><table><caption>c</caption><tr><th>1</th></tr></table>": "th without scope",
    "<h1>a</h1><table><caption>c</caption><tr><td>1</td></tr><tr></tr></table>": (
        "rows of [0, 1] cells"
    ),
    "<h1>a</h1><a href='https://b'>b</a>": "a href=https://b",
    "<h1>a</h1><a href='javascript:b'>b</a>": "a href=javascript:b",
    "<h1 onclick='b'>a</h1>": "h1 onclick",
    "<h1>a</h1><style>a { background: url(b) }</style>": "style that fetches",
    "<h1 id='a'>a</h1><p id='a'></p>": "two of id a",
    "<h1 aria-labelledby='a'>a</h1>": "aria-labelledby of nothing",
    "<h1>a</h1><a href='#b'>b</a>": "link to #b",
}


@pytest.mark.parametrize(("html", "fault"), BROKEN.items(), ids=BROKEN.values())
def test_the_page_check_finds_faults(html, fault):
    assert find_faults(html) == [fault]


def test_an_element_left_open_is_found():
    with pytest.raises(AssertionError):
        find_faults("<h1>a</h1><p>b")
