"""One conformance suite over every identification method of the registry."""

import ast
from pathlib import Path

import numpy as np
import pytest

from workbench import identification
from workbench.data import Dataset, Experiment
from workbench.errors import InputError
from workbench.identification import METHODS
from workbench.lpv import LPVModel, load_model

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def records():
    """Two records of y(k) = 0.8 y(k-1) + p u(k-1) with a schedule that moves, two inputs, one of them without effect."""
    found = []
    for seed in (1, 2):
        random = np.random.default_rng(seed)
        N = 800
        u, p, y = random.normal(size=(N, 2)), np.linspace(1.0, 2.0, N), np.zeros(N)
        for k in range(1, N):
            y[k] = 0.8 * y[k - 1] + p[k - 1] * u[k - 1, 0]
        y += 0.05 * random.normal(size=N)
        inputs = {"u1": u[:, 0], "u2": u[:, 1]}
        found.append(Experiment.from_arrays(f"r{seed}", 0.1, inputs=inputs, outputs={"y": y}, schedule={"p": p}))
    return Dataset(tuple(found))


@pytest.fixture(scope="module", params=METHODS.values(), ids=METHODS)
def fitted(request, records):
    method = request.param()
    return method, method.fit(records)


def test_fit_gives_a_model_that_knows_its_channels_and_range(fitted, records):
    _, model = fitted
    assert isinstance(model, LPVModel)
    assert [c.name for c in model.inputs] == ["u1", "u2"]
    assert [c.name for c in model.outputs] == ["y"]
    assert model.dt == records.dt
    assert model.predictor is not None
    assert model.estimates  # every estimate comes with its uncertainty
    assert all(e.std >= 0 for e in model.estimates)
    assert model.noise is not None
    if model.schedule:
        np.testing.assert_allclose(model.span, [1.0, 2.0])


def test_options_are_unchanged_and_a_second_fit_is_the_same(fitted, records):
    method, model = fitted
    again = method.fit(records)
    assert np.array_equal(again.A, model.A)
    assert np.array_equal(again.C, model.C)
    with pytest.raises(AttributeError):
        method.order = 3


def test_file_and_back(fitted, records, tmp_path):
    _, model = fitted
    model.save(tmp_path / "m.json")
    again = load_model(tmp_path / "m.json")
    for e in records:
        assert np.array_equal(again.simulate(e), model.simulate(e))
        assert np.array_equal(again.predict(e, 3), model.predict(e, 3))
    assert again.notes == model.notes
    assert [e.name for e in again.estimates] == [e.name for e in model.estimates]


def test_frozen_model_is_the_python_control_system(fitted):
    _, model = fitted
    A, _, _, _ = model.freeze(1.5)
    system = model.to_control(1.5)
    assert system.dt == model.dt
    assert list(system.input_labels) == ["u1", "u2"]
    np.testing.assert_allclose(np.sort_complex(system.poles()), np.sort_complex(np.linalg.eigvals(A)))


def test_records_without_outputs_are_refused(fitted, records):
    method, _ = fitted
    bare = Dataset(tuple(e.select(["u1", "u2", "p"]) for e in records))
    with pytest.raises(InputError, match="output"):
        method.fit(bare)


def test_every_method_is_in_the_registry():
    """A class whose fit returns an LPVModel is a method: whoever adds one must list it."""
    found = set()
    for path in Path(identification.__file__).parent.rglob("*.py"):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not any("Protocol" in ast.unparse(b) for b in node.bases):
                for item in node.body:
                    if isinstance(item, ast.FunctionDef) and item.name == "fit" and item.returns is not None:
                        found |= {node.name} if ast.unparse(item.returns) == "LPVModel" else set()
    assert found == {method.__name__ for method in METHODS.values()} | {"ByCriterion"}  # which refines what a method gives
