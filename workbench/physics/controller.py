"""What a simulation needs to know of a controller: one law in plain arithmetic, with explicit memory."""

from typing import Any, Protocol, runtime_checkable

import numpy as np

from workbench.records import field, record


class Loop(Protocol):
    """What is common to all sampled controllers with zero-order hold: what they read and what they command."""

    @property
    def name(self) -> str: ...
    @property
    def dt(self) -> float: ...
    @property
    def references(self) -> tuple[str, ...]:
        """Names of the set-points r."""
        ...

    @property
    def measured(self) -> tuple[str, ...]:
        """Names of the measured outputs y."""
        ...

    @property
    def schedule(self) -> str | None:
        """Name of the measured output that is rho, if the law is scheduled."""
        ...

    @property
    def actuated(self) -> tuple[str, ...]:
        """Names of the inputs u."""
        ...


@runtime_checkable
class Controller(Loop, Protocol):
    """A law that is an equation: (state, r, y, rho) -> (u, state) every dt seconds.

    `law` is one plain function of arithmetic and numpy ufuncs without a branch on its arguments, so that the stepper can
    compile it; `gains` holds every number in it, so that other gains need no other kernel.
    """

    @property
    def gains(self) -> np.ndarray: ...
    def init(self, u: np.ndarray | None = None) -> np.ndarray:
        """The memory before the first sample; given u, that with which the first command is u, where the law can."""
        ...

    def law(self, gains: Any, state: Any, r: Any, y: Any, rho: Any) -> tuple[list, list]:
        """The law on numbers, arrays or symbols."""
        ...


class Stepped(Loop, Protocol):
    """A law that is computed step by step in Python, such as an optimisation; its memory is whatever it needs."""

    def init(self, u: np.ndarray | None = None) -> Any:
        """The memory before the first sample; u: the inputs it takes over from."""
        ...

    def step(self, state: Any, r: np.ndarray, y: np.ndarray, rho: float | None) -> tuple[np.ndarray, Any]:
        """One sample: commands (nu,), never NaN, and the next memory."""
        ...


@record
class Playback:
    """u = r: the inputs follow given sequences, whatever is measured. An experiment in open loop."""

    actuated: tuple[str, ...]
    dt: float = field("", unit="s", low=1e-9)
    name: str = "playback"
    measured: tuple[str, ...] = ()
    schedule: str | None = None

    @property
    def references(self) -> tuple[str, ...]:
        return self.actuated

    @property
    def gains(self) -> np.ndarray:
        return np.empty(0)

    def init(self, u: np.ndarray | None = None) -> np.ndarray:
        """No memory."""
        del u
        return np.empty(0)

    def law(self, gains: Any, state: Any, r: Any, y: Any, rho: Any = None) -> tuple[list, list]:
        """The reference itself."""
        del gains, state, y, rho
        return list(r), []
