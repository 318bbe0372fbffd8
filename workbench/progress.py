"""What is being done, for whoever waits for it: one kind of callback, and the time left where the number of steps is known.

A callback is given a line of text. What it does with it is its own matter: the command line writes it to standard error.

    steps = Steps(print, 40, "runs")
    steps.done(10, "the loop at 0.3 m/s")       # the loop at 0.3 m/s (10 of 40 runs, 25 s left)
"""

import time
from collections.abc import Callable

Progress = Callable[[str], None]


def silent(text: str) -> None:
    """Tells nobody."""
    del text


def time_said(seconds: float) -> str:
    """40 s, 12 min or 3.5 h: as exact as such an estimate is."""
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 6000.0 else f"{seconds / 3600.0:.1f} h"


class Steps:
    """Steps of a known number `whole`, called `what`: told with how many are done, and with the time that the rest will take.

    before: how many of them were done earlier, in no time. pause [s]: the least time between two lines; the last is always told.
    """

    def __init__(self, progress: Progress, whole: int, what: str, *, before: int = 0, pause: float = 0.0):
        self.progress, self.whole, self.what, self.before, self.pause = progress, whole, what, before, pause
        self.made = 0
        self.began = self.told = time.monotonic()

    @property
    def left(self) -> float:
        """Seconds that the rest will take, if it goes on as it went; 0 before the first step."""
        each = (time.monotonic() - self.began) / max(self.made, 1)
        return each * (self.whole - self.before - self.made) * (self.made > 0)

    def counted(self, aside: str = "") -> str:
        """12 of 40 runs, 25 s left; aside: what stands between, such as "2 failed"."""
        done = self.before + self.made
        left = f"{time_said(self.left)} left" if self.made > 0 and done < self.whole else ""
        return ", ".join(filter(None, [f"{done} of {self.whole} {self.what}", aside, left]))

    def done(self, steps: int = 1, text: str = "", aside: str = "") -> None:
        """So many more are done; text: what the line begins with."""
        self.made += steps
        now = time.monotonic()
        if now - self.told >= self.pause or self.before + self.made >= self.whole:
            self.told = now
            self.progress(f"{text} ({self.counted(aside)})" if text else self.counted(aside))
