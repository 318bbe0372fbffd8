"""Exported C, compiled by the system's compiler and called through ctypes; nothing here reads the export's templates."""

import ctypes
import shutil
import subprocess

import numpy as np
import pytest

COMPILER = next((path for name in ("cc", "gcc", "clang") if (path := shutil.which(name))), None)
FLAGS = ["-std=c99", "-O2", "-shared", "-fPIC"]
STRICT = ["-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wdouble-promotion", "-Wshadow", "-Wstrict-prototypes",
          "-Wmissing-prototypes", "-Wundef", "-Werror"]  # fmt: skip


class CompiledLaw:
    """init, take_over and step of one exported law; memory in `state`."""

    def __init__(self, law, source, *, single=False, strict=True):
        if COMPILER is None:
            pytest.skip("no C compiler (cc, gcc or clang) on this machine: the exported C is not tried")
        name, library = source.stem, source.with_suffix(".so")
        command = [COMPILER, *FLAGS, *(STRICT if strict else ()), "-o", library, source, "-lm"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        nu, ny = law.Kp.shape[1:]
        self.scheduled, self.real = law.schedule is not None, ctypes.c_float if single else ctypes.c_double

        flag, kept = ctypes.c_int if law.paths.any() else ctypes.c_bool, int(np.max(law.late) / law.dt + 1e-9) + 1
        awaits = law.late.any() or law.play.any()

        class State(ctypes.Structure):
            _fields_ = (
                ("z", self.real * nu), ("f", self.real * ny), ("d", self.real * ny),
                *((key, ctypes.c_double * ny) for key in ("s", "m", "n") * law.shaped),
                *([("line", ctypes.c_double * kept * ny), ("l", ctypes.c_double * ny)] if awaits else []), ("u", self.real * nu),
                *((key, self.real * nu) for key in ("side", "teeth") if law.inverses),
                ("cold", flag), ("takes_over", flag), ("valid", ctypes.c_bool),
                *((("outside", ctypes.c_bool),) if self.scheduled else ()), ("limit", ctypes.c_int * nu),
            )  # fmt: skip

        loaded = ctypes.CDLL(str(library))
        self._init, self._take_over, self._step = (getattr(loaded, f"{name}_{word}") for word in ("init", "take_over", "step"))
        self.state, self._u = State(), (self.real * nu)()
        ctypes.memset(ctypes.byref(self.state), 0xA5, ctypes.sizeof(State))  # init must not count on zeros

    def init(self, u=None):
        if u is None:
            self._init(ctypes.byref(self.state))
        else:
            self._take_over(ctypes.byref(self.state), self._array(u))

    def step(self, r, y, rho=None):
        """(u, limit, outside, valid)"""
        schedule = [self._array(rho) if np.ndim(rho) else self.real(rho)] if self.scheduled else []
        self._step(ctypes.byref(self.state), self._array(r), self._array(y), *schedule, self._u)
        outside = self.state.outside if self.scheduled else False
        return np.array(self._u, dtype=float), list(self.state.limit), outside, self.state.valid

    def _array(self, values):
        return (self.real * len(values))(*values)
