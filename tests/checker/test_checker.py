"""A checker that shares nothing with the workbench accepts what is proved and refuted, and no file that was spoilt."""

import ast
import io
import json
import sys
import tokenize
from copy import deepcopy
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from tests.checker import checker
from tests.workbench.robustness.loops import two_regressions
from tests.workbench.robustness.test_margins import drawn as drawn_loop
from tests.workbench.robustness.test_resimulation import DT, asked, constants, drawn
from tests.workbench.robustness.test_schedules import drawn as drawn_schedule
from workbench.errors import InputError
from workbench.files import as_read, nullable
from workbench.robustness.envelopes.constant import constant_kernel
from workbench.robustness.envelopes.kernel import kernel
from workbench.robustness.loop import close
from workbench.robustness.margins import Certificate, margin
from workbench.robustness.proof import clipped, falls, falls_in_motion, grows, limits, proof_file
from workbench.robustness.schedules import scheduled_margin
from workbench.robustness.verdict import bounds_kept

SOURCE = Path(checker.__file__)
MOST_LINES = 440  # of code; what refutes is computed exactly, which takes some forty of them
MOVING, STILL = (112, 2, 16, 19), (4, 6, 21, 33)  # seeds of drawn runs: the first with proofs at single samples


def content(claims):
    return as_read(nullable(proof_file("drawn", [("drawn", status, shown) for status, shown in claims])))


def accepted(file) -> bool:
    """Whether every claim of a file is accepted; what is no proof file has none."""
    try:
        found = checker.check(file)
    except checker.RejectedError:
        return False
    return bool(found) and all(holds for _, holds, _ in found)


# ---- what is proved is accepted ------------------------------------------------------------------------------------


def of_margin(loop) -> list:
    """A certificate and a sequence of one loop, and the certificate by corners where that is another one."""
    found = margin(loop)
    return [("PROVED", falls(found.loop, found.certified, 0.9 * found.certified.kappa)),
            ("FAILED", grows(found.loop, found.falsified, 1.1 * found.falsified.kappa))]  # fmt: skip


@cache
def of_loops() -> tuple:
    closed = close(*two_regressions())
    return tuple(entry for loop in (closed, *(drawn_loop(seed) for seed in range(6))) for entry in of_margin(loop))


@cache
def of_motion() -> tuple:
    claims = []
    for seed in range(30):
        at, nodes, rate = drawn_schedule(seed)
        try:
            found = scheduled_margin(at, nodes, rate)
        except InputError:
            continue
        claims.append(("PROVED", falls_in_motion(found.loop, found.certified, found.certified.kappa)))
        if len(claims) == 6:
            break
    return tuple(claims)


def runs_of(seed, moving) -> list:
    """Claims on a drawn loop along a run, near the band that holds all runs; moving: parameters that move may refute it."""
    loop, random = drawn(seed), np.random.default_rng([seed, 2])
    if loop is None:
        return []
    outer, constant = kernel(loop.course), constants(loop, random)
    inner, found = constant_kernel(loop.course, outer), []
    for signal in loop.signals[:2]:
        i = loop.signals.index(signal)
        band = (outer if moving else inner).half[:, i]
        for side, share in ((1, 1.02), (-1, 0.95), (1, 0.2)):
            limit = float((side * outer.nominal.v[:, i] + share * band).max())
            if np.isfinite(limit):
                bound = asked(signal, side, limit)
                kept = bounds_kept(loop.course, [bound], loop.stops, of="", dt=DT, possible=constant, moving=moving)[0]
                found += [(kept.verdict.status.value, kept.verdict.shown)] if kept.verdict.shown is not None else []
    return found


@cache
def of_runs() -> tuple:
    return tuple(entry for moving, seeds in ((True, MOVING), (False, STILL)) for seed in seeds for entry in runs_of(seed, moving))


def of_law() -> tuple:
    both = [limits("u", -2.0, 2.0), limits("v", None, 3.0)]
    return (("PROVED", clipped(both, [limits("u", -1.0, 2.0), limits("v", -1.0, 1.0)])),)


@cache
def claims() -> tuple:
    return of_loops() + of_motion() + of_runs() + of_law()


def test_every_proof_and_every_refutation_is_accepted():
    found = checker.check(content(claims()))
    assert [said for _, holds, said in found if not holds] == []
    kinds = [shown["kind"] for _, shown in claims()]
    assert all(kinds.count(kind) >= least for kind, least in (("falls", 6), ("grows", 6), ("stays", 10), ("leaves", 6)))
    assert any(shown.get("duals") for _, shown in claims())
    assert {shown["constant"] for _, shown in claims() if shown["kind"] == "stays"} == {True, False}
    assert any(shown.get("linear") for _, shown in claims())


def test_a_certificate_at_the_corners_of_several_steps_is_accepted_and_of_wider_boxes_is_not():
    loop = drawn_loop(0)
    found = margin(loop)
    assert found.certified.D is None or found.certified.steps == 1
    A = np.array([found.loop.at(0.5 * found.certified.kappa * d) for d in np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T])
    steps = next(m for m in range(1, 5) if max(np.linalg.norm(np.linalg.matrix_power(a, m), 2) for a in A) < 1.0)
    own = Certificate(0.5 * found.certified.kappa, found.certified.P, None, min(steps, 2))
    assert own.holds(found.loop)
    assert accepted(content([("PROVED", falls(found.loop, own, own.kappa))]))
    wide = replace(own, kappa=1.5 * found.falsified.kappa)
    assert not accepted(content([("PROVED", falls(found.loop, wide, wide.kappa))]))


# ---- what is false is rejected ---------------------------------------------------------------------------------------


def test_what_a_run_breaks_is_not_proved():
    """The same bound, said to be proved: with and without limits of the law, for constant parameters and for any."""
    broken = [shown for _, shown in of_runs() if shown["kind"] == "leaves"]
    assert len(broken) >= 6
    for shown in broken:
        for constant in (True, False) if shown["constant"] else (False,):
            told = {**shown, "kind": "stays", "duals": [], "constant": constant}
            assert not accepted(content([("PROVED", told)]))
            assert not accepted(content([("PROVED", {**told, "linear": []})]))


def test_both_find_the_same_bounds():
    """The sums are the same, however each of them gets there: nothing is left out by one alone."""
    shares = []
    for seed in range(40):
        if (loop := drawn(seed)) is None or not np.isfinite((outer := kernel(loop.course)).half).all():
            continue
        c = checker.course_of(content([("PROVED", {"course": loop.course})])["courses"][0])
        every, still = checker.all_runs(c, c.constant & False), checker.all_runs(c, c.constant)
        own = np.minimum(every.high, still.high) - np.maximum(every.low, still.low)
        for half, other in ((outer.half, every.high - every.low), (constant_kernel(loop.course, outer).half, own)):
            wide = half > 1e-6 * np.abs(outer.nominal.v).max()
            shares += (0.5 * other[wide] / half[wide]).tolist()
    assert len(shares) > 1000
    assert min(shares) > 0.999
    assert max(shares) < 1.0 + 1e-6


def spoilt_arrays(entry, name, random):
    """The entry with one array spoilt: signs, sizes, shapes, numbers that are none."""
    value = np.array(entry[name], dtype=float)
    for other in (-value, value[..., :-1], np.full_like(value, np.nan), np.zeros_like(value)):
        yield {**entry, name: nullable(other)}
    one = value.copy()
    one.flat[random.integers(value.size)] += 100.0 * np.abs(value).max() + 1.0
    yield {**entry, name: one.tolist()}


def spoilt(file, random):
    """Files that claim what they do not show: of `file` with one claim, each spoilt at one place."""
    entry = file["claims"][0]
    kind = entry["kind"]

    def told(**changed):
        return {**file, "claims": [{**entry, **changed}]}

    def of_course(**changed):
        return {**file, "courses": [{**file["courses"][0], **changed}]}

    yield told(status="FAILED" if entry["status"] == "PROVED" else "PROVED")
    yield told(kind="sworn")
    yield {**file, "version": 2}
    yield {**file, "claims": []}
    for name in entry:
        if name != "claim" and (name, kind) != ("steps", "falls"):  # whatever it is called, and where D is given
            yield {**file, "claims": [{key: value for key, value in entry.items() if key != name}]}
    if kind in ("falls", "falls in motion"):
        yield told(needed=2.0 * entry["kappa"])
        yield told(kappa=50.0 * entry["kappa"], needed=40.0 * entry["kappa"])
        for spoiled in spoilt_arrays(entry, "P", random):
            yield {**file, "claims": [spoiled]}
        yield told(loop={**entry["loop"], "A": (2.0 * np.array(entry["loop"]["A"])).tolist()})
    if kind == "grows":
        yield told(needed=0.5 * entry["kappa"])
        yield told(kappa=0.5 * entry["kappa"])
        yield told(delta=(1.5 * np.array(entry["delta"])).tolist())
        yield told(delta=(0.0 * np.array(entry["delta"])).tolist())
        yield told(loop={**entry["loop"], "A": (0.1 * np.array(entry["loop"]["A"])).tolist(),
                         "lam": (0.1 * np.array(entry["loop"]["lam"])).tolist()})  # fmt: skip
    if kind == "stays":
        bound = entry["bound"]
        for side, by in (("low", 1e3), ("high", -1e3)):
            tighter = [None if e is None else e + by for e in bound[side]]
            if tighter != bound[side]:
                yield told(bound={**bound, side: tighter})
        yield told(bound={**bound, "low": [None] * len(bound["low"]), "high": [None] * len(bound["low"])})
        yield told(bound={**bound, "signal": "nobody"})
        yield told(course=1)
        yield told(linear=[*entry["linear"], {"signal": bound["signal"], "low": 1e6, "high": None}])
        course = file["courses"][0]
        above = any(e is not None for e in bound["high"])
        yield of_course(g=nullable(np.array(course["g"]) + (1e6 if above else -1e6)))
        yield of_course(A=nullable(3.0 * np.array(course["A"])))
        yield of_course(lam=nullable(1e3 + 1e3 * np.array(course["lam"])))
        for dual in entry["duals"]:
            yield told(duals=[*entry["duals"], {**dual, "bound": dual["bound"] - 1e3}])
            yield told(duals=[{**dual, "P": (-np.array(dual["P"])).tolist()}])
    if kind == "leaves":
        bound = entry["bound"]
        wide = {side: [None if e is None else e * 0 + by for e in bound[side]] for side, by in (("low", -1e9), ("high", 1e9))}
        yield told(bound={**bound, **wide})
        yield told(delta=nullable(1.5 + np.array(entry["delta"])))
        yield told(before=nullable(1.5 + np.array(entry["before"])))
        yield told(sample=10**6)
        yield told(linear=[{"signal": bound["signal"], "low": 1e6, "high": None}])
    if kind == "clipped":
        yield told(own=entry["own"][:1])
        yield told(own=[{**entry["own"][0], "high": 2.5}, entry["own"][1]])
        yield told(own=[{**entry["own"][0], "low": None}, entry["own"][1]])
        yield told(own=entry["own"][::-1])


def test_no_spoilt_file_is_accepted():
    random, count = np.random.default_rng(0), 0
    for claim in claims():
        file = content([claim])
        assert accepted(file)
        for spoiled in spoilt(file, random):
            count += 1
            assert not accepted(deepcopy(spoiled)), (claim[1]["kind"], [k for k in spoiled if spoiled[k] != file.get(k)])
    assert count >= 200


def crafted(kind, courses=(), **entry):
    status = {"grows": "FAILED", "leaves": "FAILED"}.get(kind, "PROVED")
    claims = [{"kind": kind, "status": status, "claim": "crafted", **entry}]
    return as_read({"format": checker.FORMAT, "version": 1, "claims": claims, "courses": list(courses)})


def small_course(N=3, **other):
    """x+ = A x + q, two signals, one parameter that does nothing."""
    own = {
        "A": [[[1.0]]], "B": [[[0.0]]], "C": [[[0.0]]], "E": [[[1.0], [0.0]]], "F": [[[0.0], [0.0]]], "lam": [[0.0]],
        "channel": [0],
        "mode": [0] * N, "q": [[0.0]] * N, "g": [[0.0, 0.0]] * N, "f": [[0.0]] * N, "start": [0.0], "signals": ["v", "w"],
        "before": None,
    }  # fmt: skip
    return {**own, **other}


def not_normal(n=30):
    """A matrix of small whole numbers over 2 whose poles are all 0.5, and that floats take for 2.9."""
    random = np.random.default_rng(0)
    T = 0.5 * np.eye(n) + 8.0 * np.eye(n, k=1)
    for _ in range(60):
        i, j = random.choice(n, 2, replace=False)
        sign = random.choice([-1, 1])
        T[:, j] += sign * T[:, i]
        T[i] -= sign * T[j]
    return T


def test_rounding_and_underflow_show_nothing():
    """Cases that an attack has found: each was accepted, and none is true."""
    A = not_normal()
    assert np.abs(np.linalg.eigvals(A)).max() > 1.0
    still = {"B": [[0.0]] * len(A), "C": [[0.0] * len(A)], "lam": [0.0], "channel": [0]}
    assert not accepted(crafted("grows", loop={"A": A, **still}, needed=1.0, kappa=1.0, delta=[[0.0]]))
    gone = {"A": [[0.5]], "B": [[1e-170]], "C": [[1e170]], "lam": [1e-170], "channel": [0]}  # 0.5 + 1 where kappa is 1e170
    assert not accepted(crafted("falls", loop=gone, needed=1e170, kappa=1e170, P=[[1.0]], D=[0.0], steps=1))
    run = {"course": 0, "constant": False, "sample": 2, "delta": [[0.0]] * 3, "before": [0.0], "share": []}
    up = small_course(q=[[0.0], [5.0], [0.0]], g=[[0.0, 0.0], [0.0, 100.0], [0.0, 0.0]])
    bound = {"signal": "v", "low": None, "high": 1.0}
    assert accepted(crafted("leaves", [up], bound=bound, linear=[{"signal": "w", "low": None, "high": 200.0}], **run))
    for high in ([None, 1.0, 1.0], 1.0):  # w is 100 before
        assert not accepted(crafted("leaves", [up], bound=bound, linear=[{"signal": "w", "low": None, "high": high}], **run))
    lost = small_course(E=[[[1.0], [0.0]]], g=[[1.0, 0.0]] * 3, start=[1e16])  # 1e16 + 1 is 1e16 in floats
    above = {"signal": "v", "low": 1e16 + 2.0, "high": None}
    assert accepted(crafted("leaves", [lost], bound=above, linear=[], **run))
    assert not accepted(crafted("leaves", [lost], bound={**above, "low": None, "high": 1e16 + 2.0}, linear=[], **run))


def test_columns_that_underflow_count_where_their_weight_is_large():
    A, none = [[[0.0, 0.0], [0.0, 0.0]], [[0.0, 0.0], [1e-163, 0.0]]], [[0.0, 0.0]]
    course = small_course(
        A=A, B=[[[1e-162], [0.0]], [[0.0], [0.0]]], C=[none] * 2, E=[[[0.0, 1e226]]] * 2, F=[[[0.0]]] * 2, lam=[[1.0]] * 2,
        mode=[0, 1, 1], q=none * 3, g=[[0.0]] * 3, f=[[1e99], [0.0], [0.0]], start=[0.0, 0.0], signals=["v"],
    )  # fmt: skip
    stays = {"course": 0, "linear": [], "constant": False, "duals": []}
    bound = {"signal": "v", "low": -1e-3, "high": 1e-3}  # v(2) is 1
    assert not accepted(crafted("stays", [course], bound=bound, **stays))


@pytest.mark.parametrize("file", [None, [], 3, {}, {"format": checker.FORMAT, "version": 1, "claims": [{}], "courses": []}])
def test_what_is_no_proof_file_is_rejected(file):
    assert not accepted(file)


# ---- the checker itself ----------------------------------------------------------------------------------------------


def test_the_checker_is_short_and_shares_no_code():
    text = SOURCE.read_text()
    tree = ast.parse(text)
    names = [n.module if isinstance(n, ast.ImportFrom) else a.name for n in ast.walk(tree)
             if isinstance(n, ast.Import | ast.ImportFrom) for a in n.names]  # fmt: skip
    assert {name.split(".")[0] for name in names} - set(sys.stdlib_module_names) == {"numpy"}
    lines = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        words = token.string.strip() and token.type != tokenize.COMMENT and not token.string.startswith('"""')
        lines.update(range(token.start[0], token.end[0] + 1) if words else ())
    assert len(lines) <= MOST_LINES


def test_it_says_what_is_shown_and_ends_with_1_where_anything_is_not(tmp_path, capsys):
    good, bad = tmp_path / "good.json", tmp_path / "bad.json"
    good.write_text(json.dumps(content(of_law())))
    bad.write_text(good.read_text()[:-20])
    assert checker.main([str(good)]) == 0
    assert "accepted  drawn: the limits of the law itself are no wider" in capsys.readouterr().out
    assert checker.main([str(bad)]) == checker.main([str(good), str(tmp_path / "none")]) == checker.main([]) == 1
    assert "REJECTED  the file" in capsys.readouterr().out
