"""SVG on its way into a page: short paths, unique ids, the page's own colours and fonts, and nothing from the network."""

import re
import xml.etree.ElementTree as ElementTree

from workbench.report.palette import COLOURS

#: Dropped on the way in: metadata is noise, and a style or script inside a page would reach beyond its picture.
FOREIGN = {"metadata", "style", "script", "foreignObject"}

#: Paths of more points than this are traces and are written short; markers and frames stay as they are.
SHORT_PATH = 40

_CONTROL = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ufffe\uffff\ud800-\udfff]")
_COLOUR = re.compile("|".join(colour.light for colour in COLOURS))
_VARIABLE = {colour.light: f"var(--{colour.name})" for colour in COLOURS}


def printable(text: str) -> str:
    """The text with every character that neither XML nor HTML can hold replaced by a visible one."""
    return _CONTROL.sub("\N{REPLACEMENT CHARACTER}", text)


def embed(svg: str, prefix: str, label: str, described_by: str) -> str:
    """An SVG document as an inline element: ids start with `prefix`, `label` is what a screen reader says.

    Raises ValueError for a reference that leaves the document.
    """
    root = ElementTree.fromstring(svg)
    _drop_foreign(root)
    for element in root.iter():
        element.tag = _local(element.tag)
        element.attrib = {_local(key): _value(_local(key), value, prefix) for key, value in element.attrib.items()}
        if element.tag != "text" and element.text and not element.text.strip():
            element.text = None
        if element.tail and not element.tail.strip():
            element.tail = None
    kept = {key: root.attrib[key] for key in ("viewBox",) if key in root.attrib}
    root.attrib = {**kept, "role": "img", "aria-label": printable(label), "aria-describedby": described_by}
    return ElementTree.tostring(root, encoding="unicode")


def shorten(path: str) -> str:
    """Path data of straight lines in tenths of a point, each point relative to the one before; other paths as they are.

    Differences are taken between rounded points, so rounding errors do not add up along a trace.
    """
    tokens = path.split()
    if len(tokens) < 3 * SHORT_PATH or not set(re.findall("[A-Za-z]", path)) <= {"M", "L", "z"}:
        return path
    parts, x0, y0, i = [], 0, 0, 0
    while i < len(tokens):
        if tokens[i] == "z":
            parts.append("z")
            i += 1
            continue
        x, y = round(10 * float(tokens[i + 1])), round(10 * float(tokens[i + 2]))
        if tokens[i] == "M":
            parts.append(f"M{_tenths(x)} {_tenths(y)}l")
        elif (x, y) != (x0, y0):
            parts.append(f"{_tenths(x - x0)} {_tenths(y - y0)}")
        x0, y0, i = x, y, i + 3
    return " ".join(parts).replace(" -", "-").replace("l ", "l").removesuffix("l")


def _tenths(n: int) -> str:
    text = f"{n / 10:.1f}".removesuffix(".0")
    return text.replace("0.", ".", 1) if abs(n) < 10 and n else text


def _local(name: str) -> str:
    return name.rpartition("}")[2]


def _drop_foreign(parent: ElementTree.Element) -> None:
    for child in list(parent):
        if _local(child.tag) in FOREIGN:
            parent.remove(child)
        else:
            _drop_foreign(child)


def _value(key: str, value: str, prefix: str) -> str:
    if key == "id":
        return f"{prefix}-{value}"
    if key == "href":
        if not value.startswith("#"):
            raise ValueError(f"a picture refers to {value[:60]!r}; only references inside the picture are embedded")
        return f"#{prefix}-{value[1:]}"
    if key == "d":
        return shorten(value)
    if key.startswith("on"):
        raise ValueError(f"a picture carries a script in its attribute {key!r}")
    # the page's fonts: sizes stay, families are inherited
    value = re.sub(r"font: ((?:[a-z0-9]+ )*)([\d.]+px) [^;]*", r"font-size: \2", value)
    value = re.sub(r"font-family: [^;]*; ?", "", value)
    value = re.sub(r"url\(#", f"url(#{prefix}-", value)
    return _COLOUR.sub(lambda match: _VARIABLE[match.group()], value)
