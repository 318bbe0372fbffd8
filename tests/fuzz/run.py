"""Spoilt files without end: python -m tests.fuzz.run [SECONDS] [TARGET ..]; what is found is kept as crash-N, exit code 1."""

import sys
import tempfile
import time
import traceback
from pathlib import Path
from random import Random

from tests.fuzz.spoil import spoilt
from tests.fuzz.targets import targets

HANG = 10.0  # s, from which an input counts as one


def main() -> int:
    """Every target in turn, with inputs that nobody has seen before."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 600.0
    folder, random, until = Path(tempfile.mkdtemp()), Random(), time.monotonic() + seconds
    every = targets(folder)
    chosen, tries, found = sys.argv[2:] or list(every), 0, 0
    while time.monotonic() < until:
        target = every[random.choice(chosen)]
        content, began, fault = spoilt(target.seed, target.ending, random), time.monotonic(), ""
        tries += 1
        try:
            target.tried(folder, content)
        except Exception:
            fault = traceback.format_exc()
        took = time.monotonic() - began
        if fault or took > HANG:
            Path(f"crash-{found}{target.ending}").write_bytes(content)
            print(fault or f"took {took:.0f} s", f"-> crash-{found}{target.ending}")
            found += 1
    print(f"{tries} spoilt files, {found} findings")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
