"""Docstrings here are plain text: what Markdown would read as a link, an emphasis or a tag is escaped for the site.

Left as they are: code in backticks, indented blocks, and everything else that Markdown does not change.
"""

import re

import griffe

CODE = re.compile(r"(`[^`]*`)")
MARKUP = re.compile(r"([\\*_\[\]<])")


def escaped(text: str) -> str:
    """The text as Markdown that reads the same; a line that is indented by four is a block of code, and so is an
    example from its first `>>>` to the next empty line."""
    lines, example = [], False
    for line in text.split("\n"):
        example = bool(line) and (example or line.startswith(">>> "))
        lines.append(f"    {line}" if example else line if line.startswith("    ") else _line(line))
    return "\n".join(lines)


def _line(line: str) -> str:
    return "".join(part if part.startswith("`") else MARKUP.sub(r"\\\1", part) for part in CODE.split(line))


class PlainText(griffe.Extension):
    """Escapes every docstring as it is read."""

    def on_instance(self, *, obj: griffe.Object, **options: object) -> None:
        del options
        if obj.docstring:
            obj.docstring.value = escaped(obj.docstring.value)
