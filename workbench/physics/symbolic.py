"""CasADi symbols in laws that are written in numpy."""

import threading
from collections.abc import Sequence
from contextlib import contextmanager

import casadi as ca

_TRACING = threading.RLock()


@contextmanager
def symbolic_numpy():
    """numpy ufuncs accept CasADi symbols inside, whatever the global setting of CasADi is; one thread at a time."""
    with _TRACING:
        before = ca.GlobalOptions.getNumpyMode()
        ca.GlobalOptions.setNumpyMode(1)
        try:
            yield
        finally:
            ca.GlobalOptions.setNumpyMode(before)


def entries(symbol: ca.SX) -> list[ca.SX]:
    """The scalars of a symbolic column."""
    return ca.vertsplit(symbol) if symbol.numel() else []


def column(values: Sequence) -> ca.SX:
    """A symbolic column of scalars, numbers among them."""
    return ca.vertcat(*(ca.SX(value) for value in values)) if values else ca.SX(0, 1)
