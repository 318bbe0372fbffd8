"""Basis functions of a model's schedule: phi_j(rho), for one schedule variable or several.

One variable: rho is a number, an array or a CasADi symbol. Several: its last axis, or a symbol's rows, are the variables, and
`Products` of functions of one variable each expand in them.
"""

import itertools
from collections.abc import Sequence
from functools import reduce
from typing import Any

import numpy as np

from workbench.errors import InputError, check_known
from workbench.records import field, record


@record
class Powers:
    """phi_j(rho) = (rho / scale)^exponent_j; exponents may be negative, then the schedule must not cross zero.

    >>> Powers(np.array([0.0, 1.0, 2.0]), scale=10.0)(np.array([5.0]))
    array([[1.  , 0.5 , 0.25]])
    """

    exponents: np.ndarray = field("m", default=(0.0,))
    scale: float = field("", low=1e-300, default=1.0)

    def __call__(self, rho: np.ndarray) -> np.ndarray:
        return stacked(self, rho)

    def functions(self, rho) -> list:
        """phi_j at a number, an array or a CasADi symbol."""
        if self.exponents.min() < 0 and isinstance(rho, (int, float, np.ndarray)) and np.any(np.equal(rho, 0.0)):
            raise InputError(
                f"{self.names[int(self.exponents.argmin())]} of a schedule that is 0", mend="keep the schedule away from 0"
            )
        return [(rho / self.scale) ** float(e) for e in self.exponents]

    def slopes(self, rho: float) -> list:
        """d phi_j / d rho."""
        return [e / self.scale * (rho / self.scale) ** (e - 1.0) if e else 0.0 for e in self.exponents.tolist()]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple("1" if e == 0 else "rho" if e == 1 else f"rho^{e:g}" for e in self.exponents)


@record
class Gaussian:
    """phi_j(rho) = exp(-beta_j (rho - centre_j)^2); `normalised` divides by their sum, so that they add up to one.

    `with_constant` appends phi = 1, for the matrices of a model that do not move with the schedule.

        >>> np.array(Gaussian(np.array([0.0, 10.0]), beta=np.array([0.1, 0.1]), normalised=True).functions(4.0)).round(2)
        array([0.88, 0.12])
    """

    centres: np.ndarray = field("m")
    beta: np.ndarray = field("m", low=0.0)
    normalised: bool = False
    with_constant: bool = False

    def __call__(self, rho: np.ndarray) -> np.ndarray:
        return stacked(self, rho)

    def functions(self, rho) -> list:
        """phi_j at a number, an array or a CasADi symbol."""
        exponents = [-b * (rho - c) ** 2 for c, b in zip(self.centres, self.beta, strict=True)]
        if self.normalised:
            # far from every centre all of them underflow: the quotient does not when the largest is taken out first
            top = reduce(np.maximum, exponents)
            weights = [np.exp(e - top) for e in exponents]
            total = sum(weights)
            weights = [w / total for w in weights]
        else:
            weights = [np.exp(e) for e in exponents]
        return [*weights, *([0.0 * rho + 1.0] if self.with_constant else [])]

    def slopes(self, rho: float) -> list:
        """d phi_j / d rho."""
        weights = self.functions(rho)[: len(self.centres)]
        rates = [-2.0 * b * (rho - c) for c, b in zip(self.centres, self.beta, strict=True)]
        common = sum(w * r for w, r in zip(weights, rates, strict=True)) if self.normalised else 0.0
        return [*(w * (r - common) for w, r in zip(weights, rates, strict=True)), *([0.0] if self.with_constant else [])]

    @property
    def names(self) -> tuple[str, ...]:
        return (*(f"g({c:.4g})" for c in self.centres), *(("1",) if self.with_constant else ()))


@record
class PiecewiseLinear:
    """phi_j(rho) is 1 at knot_j, 0 at every other knot, linear between, constant outside the first and last knot.

    >>> PiecewiseLinear(np.array([0.0, 5.0, 10.0]))(np.array([2.5]))
    array([[0.5, 0.5, 0. ]])
    """

    knots: np.ndarray = field("m")

    def __post_init__(self):
        if np.any(np.diff(self.knots) <= 0):
            raise InputError("knots must increase")

    def __call__(self, rho: np.ndarray) -> np.ndarray:
        return stacked(self, rho)

    def functions(self, rho) -> list:
        """phi_j at a number, an array or a CasADi symbol."""
        return hats(rho, self.knots)

    def slopes(self, rho: float) -> list:
        """d phi_j / d rho; at a knot towards larger values, at the last one from smaller ones."""
        j = int(np.clip(np.searchsorted(self.knots, rho, side="right"), 1, len(self.knots) - 1))
        rise = 1.0 / (self.knots[j] - self.knots[j - 1]) if self.knots[0] <= rho <= self.knots[-1] else 0.0
        return [-rise if i == j - 1 else rise if i == j else 0.0 for i in range(len(self.knots))]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"hat({k:.4g})" for k in self.knots)


@record
class Products:
    """phi_j(rho) = prod_i factors[i]_(chosen_ji)(rho_i): functions of several variables from those of one each.

    chosen (m, ns): which function of each factor enters; by default every combination, of which piecewise linear factors
    interpolate on a grid. `polynomials` chooses all up to a degree.

        >>> hats = PiecewiseLinear(np.array([0.0, 1.0]))
        >>> Products((hats, hats))(np.array([[0.5, 1.0]]))  # the corners of a square: (0, 0), (0, 1), (1, 0), (1, 1)
        array([[0. , 0.5, 0. , 0.5]])
    """

    factors: "tuple[Curve, ...]"
    chosen: Any = None

    def __post_init__(self):
        sizes = [len(factor.names) for factor in self.factors]
        own = np.array(list(np.ndindex(*sizes)) if self.chosen is None else self.chosen, dtype=int)
        if own.ndim != 2 or own.shape[1] != len(sizes) or np.any(own < 0) or np.any(own >= sizes):
            problem = f"functions {own.tolist()} of factors with {sizes} functions"
            raise InputError(problem, mend="give each product the number, from 0, of one function of every factor")
        own.setflags(write=False)
        object.__setattr__(self, "chosen", own)

    def __call__(self, rho: np.ndarray) -> np.ndarray:
        return stacked(self, rho)

    def functions(self, rho) -> list:
        """phi_j at the variables (..., ns), or at a list of numbers or CasADi symbols."""
        columns = [rho[..., i] if isinstance(rho, np.ndarray) else rho[i] for i in range(len(self.factors))]
        return self.products([factor.functions(own) for factor, own in zip(self.factors, columns, strict=True)])

    def products(self, by: list[list]) -> list:
        """phi_j from the functions of every factor."""
        return [reduce(lambda a, b: a * b, [own[k] for own, k in zip(by, row, strict=True)]) for row in self.chosen]

    @property
    def names(self) -> tuple[str, ...]:
        by = [[_of_variable(name, i + 1) for name in factor.names] for i, factor in enumerate(self.factors)]
        rows = ([own[k] for own, k in zip(by, row, strict=True)] for row in self.chosen)
        return tuple(" ".join(name for name in row if name != "1") or "1" for row in rows)


Curve = Powers | Gaussian | PiecewiseLinear  # functions of one variable
Basis = Curve | Products


def constant(variables: int) -> Basis:
    """The one function 1, of a schedule with so many variables."""
    return CONSTANT if variables < 2 else Products((CONSTANT,) * variables)


def polynomials(degree: int, scales: np.ndarray) -> Products:
    """Every product of powers of the variables over their scales (ns) up to a total degree, the constant first.

    >>> polynomials(1, np.array([2.0, 1.0])).names
    ('1', 'rho2', 'rho1')
    """
    exponents = np.arange(degree + 1.0)
    whole = [row for row in np.ndindex(*[degree + 1] * len(scales)) if sum(row) <= degree]
    factors = tuple(Powers(exponents, float(scale)) for scale in scales)
    return Products(factors, sorted(whole, key=lambda row: (sum(row), row)))


def unity(basis: Basis) -> np.ndarray | None:
    """Weights q (m) with sum_j q_j phi_j = 1; None where these functions cannot write the constant.

    >>> unity(Powers(np.array([1.0, 0.0])))
    array([0., 1.])
    """
    names = basis.names
    if "1" in names:
        return np.eye(len(names))[names.index("1")]
    if isinstance(basis, Products):
        by = [q for factor in basis.factors if (q := unity(factor)) is not None]
        if len(by) < len(basis.factors):
            return None
        weights = np.array([np.prod([q[k] for q, k in zip(by, row, strict=True)]) for row in basis.chosen])
        # every combination that counts must be there
        return weights if np.isclose(weights.sum(), np.prod([q.sum() for q in by])) else None
    partition = isinstance(basis, PiecewiseLinear) or (isinstance(basis, Gaussian) and basis.normalised)
    return np.ones(len(names)) if partition else None


def _of_variable(name: str, i: int) -> str:
    """A function's name with the number of its variable: "rho2^3", "hat2(0.1)"."""
    return name.replace("rho", f"rho{i}") if "rho" in name else name.replace("(", f"{i}(", 1)


CONSTANT = Powers()


def hats(rho, knots: Any) -> list:
    """The functions of `PiecewiseLinear`, where the knots may be symbols too."""
    inside = np.minimum(np.maximum(rho, knots[0]), knots[-1])
    rise = [(inside - a) / (b - a) for a, b in itertools.pairwise(knots)]
    # each is the lower of the side that leads up to its knot and the side that leads down from it
    up, down = [0.0 * rho + 1.0, *rise], [*(1.0 - r for r in rise), 0.0 * rho + 1.0]
    return [np.maximum(np.minimum(a, b), 0.0) for a, b in zip(up, down, strict=True)]


def knots_of(basis: Basis) -> list[np.ndarray]:
    """The knots of a basis that interpolates linearly, of each of its variables; none of another one."""
    factors = basis.factors if isinstance(basis, Products) else (basis,)
    own = [factor.knots for factor in factors if isinstance(factor, PiecewiseLinear)]
    return own if len(own) == len(factors) else []


def functions_at(basis: Basis, rho: Any, knots: Sequence[Any]) -> list:
    """phi_j at a value, or at a list of them of several variables, with these knots in place of those of `knots_of`."""
    if not knots:
        return basis.functions(rho)
    if isinstance(basis, Products):
        return basis.products([hats(own, at) for own, at in zip(rho, knots, strict=True)])
    return hats(rho, knots[0])


def stacked(basis: Basis, rho: np.ndarray) -> np.ndarray:
    """phi(rho), (..., m)."""
    return np.stack(basis.functions(np.asarray(rho, dtype=float)), axis=-1)


BASES: dict[str, type] = {"powers": Powers, "gaussian": Gaussian, "piecewise-linear": PiecewiseLinear, "products": Products}


def basis_to_dict(basis: Basis) -> dict[str, Any]:
    """Plain numbers, with the basis' kind."""
    kind = next(kind for kind, cls in BASES.items() if isinstance(basis, cls))
    own = vars(basis)
    if isinstance(basis, Products):
        own = own | {"factors": [basis_to_dict(factor) for factor in basis.factors]}
    return {"kind": kind} | own


def basis_from_dict(content: dict[str, Any]) -> Basis:
    """The basis that `basis_to_dict` wrote."""
    options = dict(content)
    kind = check_known("basis", options.pop("kind"), BASES)
    if "factors" in options:
        options["factors"] = tuple(basis_from_dict(own) for own in options["factors"])
    return BASES[kind](**options)
