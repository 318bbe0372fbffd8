"""What a sweep runs: factors, designs and points, and the file that asks for them."""

import itertools
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from workbench.errors import InputError, check_known
from workbench.records import field, record
from workbench.toml import Table, kind, read_toml

DRAWN = ("random", "latin-hypercube", "sobol", "morris", "sobol-indices")
DESIGNS = ("grid", "list", *DRAWN)
LEVELS = 4  # of a factor on a Morris trajectory
MOST = 1_000_000  # runs of a sweep
KEYS = ("run", "design", "count", "seed", "seeds", "outputs", "parameters", "fixed")
PARAMETER = ("values", "low", "high", "count", "scale")


@record
class Factor:
    """What varies: `values`, numbers or texts, or what lies from low to high, with log evenly in its logarithm.

    count: levels that a grid takes of a range.
    """

    name: str
    values: tuple[float | str, ...] = ()
    low: float = field("", default=0.0)
    high: float = field("", default=0.0)
    count: int = 0
    log: bool = False

    def at(self, share: float) -> float | str:
        """The value at a share in [0, 1] of the range, or of the list of values."""
        if self.values:
            return self.values[min(int(share * len(self.values)), len(self.values) - 1)]
        if share in (0.0, 1.0):
            return self.high if share else self.low
        if self.log:
            value = math.exp((1.0 - share) * math.log(self.low) + share * math.log(self.high))
        else:
            value = (1.0 - share) * self.low + share * self.high
        return min(max(value, self.low), self.high)

    @property
    def levels(self) -> tuple[float | str, ...]:
        """What a grid takes of it."""
        return self.values or tuple(self.at(share) for share in np.linspace(0.0, 1.0, self.count).tolist())


@record
class Point:
    """One run: its number in the sweep, its seed, and a value for each parameter."""

    run: int
    seed: int
    values: Mapping[str, float | str]


@record
class Sweep:
    """What to run (`run`, by name) with which values; see `load_sweep` for the file.

    fixed: what stays, as `run` understands it.
    """

    run: str
    factors: tuple[Factor, ...]
    design: str = "grid"
    count: int = 0
    seed: int = 0
    seeds: tuple[int, ...] = (0,)
    outputs: tuple[str, ...] = ()
    fixed: Mapping[str, Any] = field(default_factory=dict)

    def points(self) -> list[Point]:
        """Every run of the sweep, the same whenever it is asked."""
        names = [p.name for p in self.factors]
        sets = [dict(zip(names, values, strict=True)) for values in self._sets()]
        runs = len(sets) * len(self.seeds)
        if runs > MOST:
            raise InputError(f"{runs} runs", mend=f"at most {MOST}: fewer levels, or a random design")
        return [Point(i, seed, own) for i, (own, seed) in enumerate(itertools.product(sets, self.seeds))]

    def _sets(self) -> list[tuple[float | str, ...]]:
        if self.design == "grid":
            sizes = [len(p.values) or p.count for p in self.factors]
            if math.prod(sizes) > MOST:
                raise InputError(f"a grid of {math.prod(sizes)} points", mend=f"at most {MOST}: fewer levels, or a random design")
            return list(itertools.product(*(p.levels for p in self.factors)))
        if self.design == "list":
            return list(zip(*(p.values for p in self.factors), strict=True))
        return [tuple(p.at(float(s)) for p, s in zip(self.factors, row, strict=True)) for row in self.shares()]

    def shares(self) -> np.ndarray:
        """(sets, factors) in [0, 1]: where a drawn design takes each factor.

        Of `count` Morris trajectories or Sobol base points there are count (factors + 1) or count (factors + 2) sets.
        """
        from scipy.stats import qmc

        n, random = len(self.factors), np.random.default_rng(self.seed)
        match self.design:
            case "random":
                return random.uniform(size=(self.count, n))
            case "latin-hypercube":
                return qmc.LatinHypercube(n, rng=random).random(self.count)
            case "sobol":
                return qmc.Sobol(n, rng=random).random_base2(math.ceil(math.log2(self.count)))[: self.count]
            case "morris":
                from SALib.sample.morris import sample

                return np.asarray(sample(self.problem, self.count, num_levels=LEVELS, seed=random))
            case _:
                from SALib.sample.sobol import sample

                return np.asarray(sample(self.problem, self.count, calc_second_order=False, seed=random))

    @property
    def problem(self) -> dict[str, Any]:
        """The factors as SALib wants them, each from 0 to 1."""
        return {
            "num_vars": len(self.factors),
            "names": [p.name for p in self.factors],
            "bounds": [[0.0, 1.0]] * len(self.factors),
        }

    def content(self) -> dict[str, Any]:
        """The sweep in plain values."""
        return {**vars(self), "factors": [vars(p) for p in self.factors], "fixed": dict(self.fixed)}


def load_sweep(path: str | Path) -> Sweep:
    """Read a sweep from TOML; what is unknown, missing or makes no sense is refused with key, what was expected and the mend.

    run: what is done with each set of values. design, count: grid (default), list, or one that is drawn from `seed`: random,
    latin-hypercube or sobol, and how many sets; morris or sobol-indices, whose outputs tell what each factor does, and how many
    trajectories or base points (a power of two). seeds: each set once for every one. [parameters.NAME]: values, or low and high,
    with scale = "log" for one that varies by factors, and count levels in a grid. outputs: those wanted, by default all. [fixed]:
    what stays.

        >>> [point.values for point in load_sweep("sweep.toml").points()]
        [{'J': 0.001}, {'J': 0.002}, {'J': 0.004}]
    """
    top = read_toml(path, KEYS)
    run, design = top.text("run", None), check_known("design", top.text("design", "grid"), DESIGNS, file=path)
    named = top.table("parameters", None)
    if not named.content:
        raise InputError("nothing varies", file=path, mend="give [parameters.NAME] with values = [..], or low and high")
    factors = tuple(_factor(named.table(name, PARAMETER), name, design) for name in named.content)
    count = top.whole("count", 0)
    if design in ("grid", "list") and count:
        raise top.refused("count", str(count), f"a {design} has as many points as its values make: leave it out")
    if count > MOST:
        raise top.refused("count", str(count), f"at most {MOST}")
    if design == "sobol-indices" and count & (count - 1):
        raise top.refused("count", str(count), f"a power of two: {2 ** (count.bit_length() - 1)} or {2 ** count.bit_length()}")
    if design in ("morris", "sobol-indices") and len(factors) < 2:
        raise InputError(f"design {design} with one parameter", file=path, mend="give two or more: their effects are compared")
    if design == "morris" and (odd := [p for p in factors if p.values and len(p.values) not in (2, LEVELS)]):
        problem = f"{odd[0].name} has {len(odd[0].values)} values, a Morris trajectory takes 2 or {LEVELS}"
        raise InputError(problem, file=path, mend="give 2 or 4 values, or low and high")
    if design in ("morris", "sobol-indices") and count == 1:
        raise top.refused("count", "1", "two or more, usual are 10 to 50 trajectories, 256 to 4096 base points")
    if design not in ("grid", "list") and count < 1:
        raise InputError(f"design {design} without count", file=path, mend="give count = 100, the sets of values to draw")
    lengths = {len(p.values) for p in factors}
    if design == "list" and len(lengths) > 1:
        said = ", ".join(f"{p.name} {len(p.values)}" for p in factors)
        raise InputError(f"a list of values of different lengths: {said}", file=path, mend="one value of each for every run")
    seeds = top.content.get("seeds", [top.whole("seed", 0)])
    if (
        not isinstance(seeds, list)
        or not seeds
        or not all(type(s) is int and 0 <= s < 2**63 for s in seeds)
        or len({*seeds}) < len(seeds)
    ):
        raise top.refused("seeds", kind(seeds), "expected whole numbers from 0 on, each once: seeds = [1, 2, 3]")
    fixed = top.table("fixed", None).content
    return Sweep(run, factors, design, count, top.whole("seed", 0), tuple(seeds), top.texts("outputs", ()), fixed)


def _factor(own: Table, name: str, design: str) -> Factor:
    given, low, high = own.content.get("values"), own.number("low"), own.number("high")
    if given is not None:
        if not isinstance(given, list) or not given or not all(_is_value(v) for v in given):
            raise own.refused("values", kind(given), "expected numbers or texts: values = [0.5, 1.0, 2.0]")
        if other := [key for key in own.content if key != "values"]:
            raise own.refused(other[0], kind(own.content[other[0]]), "leave it out: the values are given")
        return Factor(name, tuple(v if isinstance(v, str) else float(v) for v in given))
    if low is None or high is None or design == "list":
        mend = "give values = [..]" + ("" if design == "list" else ", or low and high")
        raise InputError(f"[{own.name}] has no values", file=own.file, mend=mend)
    if not low < high:
        raise own.refused("high", f"{high:g}", f"expected more than low = {low:g}")
    scale = check_known("scale", own.text("scale", "linear"), ("linear", "log"), file=own.file)
    if scale == "log" and low <= 0.0:
        raise own.refused("low", f"{low:g}", "expected a number above 0 for a logarithmic scale")
    count = own.whole("count", 0)
    if design == "grid" and count < 2:
        raise InputError(f"[{own.name}] has no levels", file=own.file, mend="give count = 5, or values = [..]")
    if design != "grid" and count:
        raise own.refused("count", str(count), f"levels belong to a grid, the design is {design}: leave it out")
    return Factor(name, (), low, high, count, scale == "log")


def _is_value(value: Any) -> bool:
    number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    return isinstance(value, str) or number
