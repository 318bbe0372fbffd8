"""The script that makes a picture one to work with: pan, zoom, values under the pointer, series on and off, other records.

It draws from the numbers behind the picture, which lie in the page: over the first column where that rises (time, frequency), one
panel for each unit; as a family with a slider where the first column starts again for every value of the second (a schedule);
in the plane where columns are pairs of real and imaginary parts. Keys do all that a pointer does, and what is under the cursor is
said in words. Numbers of another form have no such view. The drawn picture stays the one that is printed.
"""

import base64
import html
import json
from pathlib import Path

import numpy as np

from workbench.report.blocks import Column, Data
from workbench.report.svg import printable

FEWEST = 8  # rows of something that one could move about in

SCRIPT = Path(__file__).with_name("explorer.js").read_text(encoding="utf-8")


def kind_of(data: Data) -> str:
    """How numbers are explored: line, family or plane; empty where they are not."""
    columns = [values for column in data.columns if (values := numbers_of(column)) is not None]
    if len(columns) < 2 or len(columns[0]) < FEWEST or numbers_of(data.columns[0]) is None:
        return ""
    names = [column.name for column in data.columns]
    if len(names) % 2 == 0 and all(n.endswith((" real", " imaginary")[i % 2]) for i, n in enumerate(names)):
        return "plane"
    x = columns[0]
    if not np.isfinite(x).all():
        return ""
    starts = np.concatenate([[0], np.flatnonzero(np.diff(x) <= 0.0) + 1])
    if len(starts) == 1:
        return "line"
    each = len(x) // len(starts)
    even = each > 3 and np.array_equal(starts, each * np.arange(len(starts))) and each * len(starts) == len(x)
    if even and len(columns) > 2 and (np.ptp(columns[1].reshape(-1, each), axis=1) == 0.0).all():
        return "family"
    return ""


def numbers_of(column: Column) -> np.ndarray | None:
    """The values as numbers, NaN where there are none; None where one of them is a text."""
    if isinstance(column.values, np.ndarray) and column.values.dtype.kind in "fiu":
        return np.where(np.isinf(column.values), np.nan, column.values).astype(float)
    try:
        values = np.array([np.nan if v is None or v == "" else v for v in column.values], dtype=float)
    except (TypeError, ValueError):
        return None
    return np.where(np.isinf(values), np.nan, values)


def packed(data: Data) -> str:
    """The numbers in 16 bits each, of a range of their own, for data that are too long to lie in the page as text."""
    told, parts, over = [], [], 2 if kind_of(data) == "family" else 1  # columns that the others are over
    for column in data.columns:
        v = numbers_of(column)
        if v is None:
            continue
        title, finite = printable(str(column)), v[np.isfinite(v)]
        low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
        even = low + (high - low) / max(len(v) - 1, 1) * np.arange(len(v))
        if len(finite) == len(v) and high > low and np.abs(v - even).max() < 1e-9 * (high - low):
            told.append({"title": title, "even": True, "low": low, "step": (high - low) / (len(v) - 1)})
            continue
        if len(told) < over:  # is not to be rounded
            told.append({"title": title, "wide": base64.b64encode(v.astype("<f8").tobytes()).decode()})
            continue
        step = (high - low) / 65534 or 1.0
        told.append({"title": title, "low": low, "step": step})
        parts.append(np.where(np.isfinite(v), np.round((np.nan_to_num(v, posinf=low, neginf=low) - low) / step) - 32767, -32768))
    raw = np.concatenate(parts).astype("<i2").tobytes() if parts else b""
    head = html.escape(json.dumps(told), quote=True)
    rows = len(data.columns[0].values)
    text = base64.b64encode(raw).decode()
    return f'<script type="application/octet-stream" data-rows="{rows}" data-columns="{head}">{text}</script>'
