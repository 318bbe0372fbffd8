"""What an output depends on: analytic indices of known functions, exact effects of a linear one, and what is refused."""

import math

import numpy as np
import pytest

from workbench.errors import InputError
from workbench.sensitivity import Index, response_surface, sensitivity
from workbench.sweeps.design import Factor, Sweep, load_sweep
from workbench.sweeps.rows import Rows

A, B = 7.0, 0.1


def rows_of(sweep, function, *, fail=(), unit="m"):
    """The rows that a sweep would have written, with an output `f`; fail: numbers of runs without one."""
    names = ("run", "seed", *(p.name for p in sweep.factors), "f", "error")
    made = []
    for point in sweep.points():
        value = None if point.run in fail else float(function(*point.values.values(), point.seed))
        made.append((point.run, point.seed, *point.values.values(), value, "lost" if value is None else ""))
    units = {"run": "", "seed": "", **{p.name: "" for p in sweep.factors}, "f": unit}
    units = {k: v for k, v in units.items() if k not in ("run", "seed")}
    return Rows(names, units, tuple(p.name for p in sweep.factors), tuple(made))


def ishigami(a, b, c, _seed):
    return math.sin(a) + A * math.sin(b) ** 2 + B * c**4 * math.sin(a)


THREE = tuple(Factor(name, (), -math.pi, math.pi) for name in "abc")


@pytest.mark.slow
def test_sobol_indices_are_those_of_ishigami_and_homma():
    """1990: V1 = (1 + b pi^4/5)^2/2, V2 = a^2/8, V13 = b^2 pi^8 (1/18 - 1/50), all else 0."""
    V1, V2 = 0.5 * (1.0 + B * math.pi**4 / 5.0) ** 2, A**2 / 8.0
    V13 = B**2 * math.pi**8 * (1.0 / 18.0 - 1.0 / 50.0)
    V = V1 + V2 + V13
    sweep = Sweep("f", THREE, "sobol-indices", 2048, seed=3)
    assert len(sweep.points()) == 2048 * 5
    found = {i.factor: i for i in sensitivity(sweep, rows_of(sweep, ishigami))}
    for name, first, total in (("a", V1 / V, (V1 + V13) / V), ("b", V2 / V, V2 / V), ("c", 0.0, V13 / V)):
        assert found[name].value == pytest.approx(first, abs=0.02)
        assert found[name].beside == pytest.approx(total, abs=0.02)
        assert found[name].low - 0.01 <= first <= found[name].high + 0.01


def test_morris_effects_of_a_linear_function_are_its_slopes_over_the_whole_range():
    sweep = Sweep(
        "f", (Factor("a", (), 0.0, 2.0), Factor("b", (), 1.0, 100.0, log=True), Factor("c", (5.0, 6.0))), "morris", 6, seed=1
    )
    found = {i.factor: i for i in sensitivity(sweep, rows_of(sweep, lambda a, b, c, s: 3.0 * a - math.log(b) + 0.0 * c))}
    assert found["a"].value == pytest.approx(6.0, rel=1e-9)
    assert found["b"].value == pytest.approx(math.log(100.0), rel=1e-9)
    assert found["c"].value == pytest.approx(0.0, abs=1e-9)
    assert all(i.beside == pytest.approx(0.0, abs=1e-9) and i.unit == "m" for i in found.values())
    listed = {i.factor: i.value for i in sensitivity(sweep, rows_of(sweep, lambda a, b, c, s: 1.2 * a / 2.0 + (c - 5.0)))}
    assert listed["a"] == pytest.approx(1.2)
    assert listed["c"] == pytest.approx(1.0)  # from the one of two values to the other
    curved = {i.factor: i for i in sensitivity(sweep, rows_of(sweep, lambda a, b, c, s: (a - 1.0) ** 2 + (c - 5.0) * a))}
    assert curved["a"].beside > 0.5


def test_seeds_are_averaged_and_not_taken_for_factors():
    sweep = Sweep("f", THREE[:2], "morris", 8, seeds=(1, 2, 3))
    found = sensitivity(sweep, rows_of(sweep, lambda a, b, seed: a + 100.0 * seed))
    assert [(i.factor, round(i.value, 9)) for i in found] == [("a", round(2.0 * math.pi, 9)), ("b", 0.0)]


def test_missing_runs_are_told_and_not_filled_in():
    sweep = Sweep("f", THREE[:2], "morris", 4)
    with pytest.raises(InputError, match=r"(?s)no indices of f: 2 sets of values have no number.*narrower range"):
        sensitivity(sweep, rows_of(sweep, lambda a, b, s: a, fail=(0, 5)))
    sweep = Sweep("f", THREE[:2], "random", 200, seed=2)
    (found, _) = sensitivity(sweep, rows_of(sweep, lambda a, b, s: math.exp(a), fail=range(50)))
    assert found.value == pytest.approx(1.0, abs=1e-9)  # any monotone relation
    assert not sensitivity(sweep, rows_of(sweep, lambda a, b, s: 2.0))


@pytest.mark.slow
def test_rank_intervals_hold_the_correlation_of_the_population():
    """Normal scores: Spearman's rho of a bivariate normal is 6/pi asin(r/2)."""
    from scipy.stats import norm

    r, inside = 0.6, 0
    truth = 6.0 / math.pi * math.asin(r / 2.0)
    for seed in range(200):
        sweep = Sweep("f", (Factor("a", (), 1e-9, 1.0 - 1e-9), Factor("b", (), 1e-9, 1.0 - 1e-9)), "random", 60, seed=seed)
        found = sensitivity(sweep, rows_of(sweep, lambda a, b, s: r * norm.ppf(a) + math.sqrt(1 - r * r) * norm.ppf(b)))
        inside += found[0].low <= truth <= found[0].high
    assert 180 <= inside <= 200


def test_a_quadratic_is_its_own_response_surface():
    random = np.random.default_rng(0)
    a, b, c = random.uniform(1.0, 3.0, 40), random.uniform(-5.0, 5.0, 40), random.uniform(0.0, 1e-3, 40)

    def f(a, b, c):
        return 2.0 + a - 0.3 * a * b + b**2 + 500.0 * c * a

    found = response_surface({"a": a, "b": b, "c": c}, f(a, b, c))
    assert found is not None
    assert found.explained == pytest.approx(1.0, abs=1e-9)
    x, y = np.meshgrid([1.0, 2.0, 3.0], [-4.0, 4.0])
    middle = 0.5 * (c.min() + c.max())
    np.testing.assert_allclose(found.over("a", "b")(x, y), f(x, y, middle), rtol=1e-9)
    noise = response_surface({"a": a, "b": b}, random.normal(size=40))
    assert noise is not None
    assert noise.explained < 0.4
    assert response_surface({"a": a[:5], "b": b[:5]}, a[:5]) is None
    assert response_surface({"a": np.ones(40), "b": b}, b) is None


def test_a_factor_that_acts_with_others_counts_for_more_than_noise_around_nothing():
    alone, noise = (Index("y", name, "S", value, value - 0.5, value + 0.5, "", total) for name, value, total in
                    (("real", 0.3, 0.9), ("noise", -0.35, 0.1)))  # fmt: skip
    assert max((alone, noise), key=lambda i: i.weight) is alone
    assert Index("y", "a", "rank", -0.9, -1.0, -0.8).weight == 0.9


@pytest.mark.parametrize(
    ("design", "count", "said"),
    [("sobol-indices", 100, "a power of two: 64 or 128"), ("morris", 1, "two or more"), ("morris", 0, "without count")],
)
def test_designs_that_cannot_be_are_refused(tmp_path, design, count, said):
    file, one = tmp_path / "s.toml", "[parameters.{}]\nlow = 0\nhigh = 1\n"
    head = f'run = "closed-loop"\ndesign = "{design}"\n'
    file.write_text(f"{head}count = {count}\n{one.format('a')}{one.format('b')}")
    with pytest.raises(InputError, match=said):
        load_sweep(file)
    file.write_text(f"{head}count = 4\n{one.format('a')}")
    with pytest.raises(InputError, match="one parameter"):
        load_sweep(file)
