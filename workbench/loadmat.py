"""The real numeric variables of a MAT file, as NPZ on standard output: python loadmat.py FILE

Run in a process of its own: on a damaged file scipy's reader may end its process with a segmentation fault.
"""

import io
import sys

import numpy as np


def main(path: str) -> None:
    """Write the variables of a file, or raise what scipy raises."""
    from scipy.io import loadmat

    content = loadmat(path)
    found = {
        name: np.asarray(array, float)
        for name, array in content.items()
        if isinstance(array, np.ndarray) and array.ndim == 2 and array.dtype.kind in "buif" and not name.startswith("__")
    }
    room = io.BytesIO()
    np.savez(room, np.array(list(found), dtype=str), *found.values())
    sys.stdout.buffer.write(room.getvalue())


if __name__ == "__main__":
    try:
        main(sys.argv[1])
    except Exception as reason:
        sys.exit(type(reason).__name__)
