"""One quick run of the winding study for all the tests that read it."""

import pytest

from studies import winding_models
from workbench.report import figures


@pytest.fixture(scope="session")
def winding_study(tmp_path_factory):
    """folder, path of the page, what was said, and what went to the two figures that show the truth."""
    folder, said, seen = tmp_path_factory.mktemp("study"), [], {}
    original = figures.coefficient_functions, figures.frozen_responses
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(figures, "coefficient_functions", lambda *a, **k: seen.update(coefficients=a) or original[0](*a, **k))
        patch.setattr(figures, "frozen_responses", lambda *a, **k: seen.update(frozen=a) or original[1](*a, **k))
        path = winding_models.main(quick=True, folder=folder, seed=5, say=said.append, progress=lambda _: None)
    return folder, path, "\n".join(said), seen
