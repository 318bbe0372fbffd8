"""A command in a process of its own, whose state is in files: it survives the page, a reload and the end of the server.

    python -m studies.app.job .steps/03-diagnose.json

The file holds the words of the command. Beside it the process keeps `.log` (what the command says), `.alive` (touched while it
runs) and, when it ends, `.end` (exit code and seconds). Who wants it to stop writes `.stop`.
"""

import _thread
import os
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path

from studies.cli import INTERRUPTED, console
from workbench.files import read_json, write_json

BEAT = 0.5  # s between two signs of life
GONE = 20.0  # s without one, after which a process is taken for dead; a loaded machine may pause one for some
PATIENCE = 5.0  # s that a command has to end by itself once it is stopped


def main(words: Sequence[str]) -> int:
    """Run the command that the file names; returns its exit code."""
    step = Path(words[0])
    alive, began = step.with_suffix(".alive"), time.monotonic()
    alive.touch()
    ended = threading.Event()
    threading.Thread(target=_watch, args=(step, ended), daemon=True).start()
    code = INTERRUPTED
    try:
        sys.argv = ["workbench", *read_json(step)["words"]]
        code = console()
    except KeyboardInterrupt:  # before the command could say so itself
        pass
    except SystemExit as reason:
        code = reason.code if isinstance(reason.code, int) else 1
    finally:
        ended.set()
        sys.stdout.flush()
        write_json(step.with_suffix(".end"), {"code": code, "seconds": round(time.monotonic() - began, 1)})
        alive.unlink(missing_ok=True)
    return code


def _watch(step: Path, ended: threading.Event) -> None:
    """Show that this process lives, and end it where it is told to stop: first by an interrupt, then at once."""
    began, stopped = time.monotonic(), 0.0
    while not ended.wait(BEAT):
        os.utime(step.with_suffix(".alive"))
        if not stopped and step.with_suffix(".stop").exists():
            stopped = time.monotonic()
            _thread.interrupt_main()
        elif stopped and time.monotonic() - stopped > PATIENCE:  # compiled code hears no interrupt
            seconds = round(time.monotonic() - began, 1)
            write_json(step.with_suffix(".end"), {"code": INTERRUPTED, "seconds": seconds})
            step.with_suffix(".alive").unlink(missing_ok=True)
            os._exit(INTERRUPTED)


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
