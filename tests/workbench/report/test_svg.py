"""An SVG inside a page: nothing leaves the document, ids do not collide, and short paths still go through the points."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from workbench.report.svg import embed, printable, shorten

NUMBER = re.compile(r"-?(?:\d+\.?\d*|\.\d+)")


def document(inside: str) -> str:
    return (
        '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" viewBox="0 0 9 9" width="9pt">'
        f"{inside}</svg>"
    )


def points(path: str) -> list[np.ndarray]:
    """The vertices of every piece of `M x y l dx dy dx dy ...`, as a browser would find them."""
    pieces = []
    for piece in path.split("M")[1:]:
        start, _, steps = piece.replace("z", "").partition("l")
        pairs = [np.array(NUMBER.findall(part), float).reshape(-1, 2) for part in (start, steps)]
        pieces.append(np.cumsum(np.concatenate(pairs), axis=0))
    return pieces


@pytest.mark.slow
@given(st.lists(st.tuples(st.floats(-2000, 2000), st.floats(-2000, 2000)), min_size=60, max_size=200))
def test_a_shortened_path_goes_through_every_point_within_a_tenth_of_a_point(vertices):
    path = "M " + " L ".join(f"{x:f} {y:f}" for x, y in vertices)
    (found,) = points(shorten(path))
    # a vertex that falls on the one before is left out, nothing else is
    rounded = [tuple(np.round([float(f"{x:f}") * 10, float(f"{y:f}") * 10])) for x, y in vertices]
    expected = [p for i, p in enumerate(rounded) if i == 0 or p != rounded[i - 1]]
    np.testing.assert_allclose(found * 10, expected, atol=1e-6)


def test_a_path_keeps_its_breaks_and_its_closing():
    line = [f"{x} {y}" for x, y in enumerate(np.sin(np.arange(50)).round(3))]
    first, second = points(shorten(f"M {' L '.join(line[:25])} M {' L '.join(line[25:])} z"))
    assert len(first) == len(second) == 25
    assert shorten(f"M {' L '.join(line)} z").endswith("z")


def test_curves_and_short_paths_are_left_alone():
    curve = "M 0 0 " + "C 1 1 2 2 3 3 " * 60
    assert shorten(curve) == curve
    assert shorten("M 0.123456 1 L 2 3") == "M 0.123456 1 L 2 3"


def test_ids_and_the_references_to_them_get_the_same_prefix():
    inside = embed(
        document('<defs><clipPath id="c"/><path id="m"/></defs><use xlink:href="#m" clip-path="url(#c)"/>'), "p1", "x", "y"
    )
    assert 'id="p1-c"' in inside
    assert 'clip-path="url(#p1-c)"' in inside
    assert 'href="#p1-m"' in inside


@pytest.mark.parametrize("address", ["http://example.org/a.png", "//example.org/a.png", "file:///etc/passwd", "a.png"])
def test_a_reference_out_of_the_document_is_refused(address):
    with pytest.raises(ValueError, match="only references inside"):
        embed(document(f'<image xlink:href="{address}"/>'), "p", "x", "y")


def test_scripts_styles_and_event_handlers_do_not_come_along():
    inside = embed(document("<script>alert(1)</script><style>p{}</style><metadata>who</metadata><g/>"), "p", "x", "y")
    assert not re.search("script|style|metadata|alert", inside)
    with pytest.raises(ValueError, match="script"):
        embed(document('<g onload="alert(1)"/>'), "p", "x", "y")


def test_the_label_is_escaped():
    assert 'aria-label="&lt;b&gt;x&lt;/b&gt;&amp;&quot;"' in embed(document(""), "p", '<b>x</b>&"', "y")


def test_printable_leaves_text_alone_and_replaces_what_no_page_can_hold():
    assert printable("µ ω\t² 漢字\n") == "µ ω\t² 漢字\n"
    assert printable("a\x00b\x1b\ud800") == "a\ufffdb\ufffd\ufffd"
