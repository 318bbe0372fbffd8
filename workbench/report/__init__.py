"""Reports: one self-contained page, pictures first, the numbers behind every picture one click away.

The page needs no matplotlib; only `workbench.report.figures` imports it, and nothing else in the library does.
"""

from workbench.report.blocks import (
    Badge,
    Brief,
    Column,
    Data,
    Picture,
    Provenance,
    Report,
    Section,
    Standing,
    Table,
    Text,
)
from workbench.report.page import write_report

__all__ = [
    "Badge", "Brief", "Column", "Data", "Picture", "Provenance", "Report", "Section", "Standing", "Table", "Text", "write_report",
]  # fmt: skip
