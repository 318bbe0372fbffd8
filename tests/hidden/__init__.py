"""Records with hidden effects, on which a diagnosis is measured; nothing here takes an equation from the workbench.

The machines are written a second time, as elongations and angles integrated at 0.25 to 2 ms, with missing physics of another
kind than the catalogue's where there is one: bristles for dry friction, the geometry of an eccentric reel, buffers, filters and
play on the fine grid. Only names, units, numbers of the data sheets and their tolerances are shared. The door is
`draw` in case.py.
"""

from pathlib import Path

COMPILED = ("parts.py", "winding.py", "robot.py", "axis.py")


def forget_stale_kernels(folder: Path) -> None:
    """Remove compiled functions older than their newest source: numba looks at a function's own file, not at what it calls."""
    newest = max(path.stat().st_mtime for path in map(folder.joinpath, COMPILED))
    for path in (folder / "__pycache__").glob("*.nb[ic]"):
        if path.stat().st_mtime < newest:
            path.unlink(missing_ok=True)


forget_stale_kernels(Path(__file__).parent)
