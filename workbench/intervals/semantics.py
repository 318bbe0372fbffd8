"""What an interval model promises about the samples it was made from.

Parameters theta in centre +- radius, regressors psi in psi_k +- r (measured value and error bound), outputs y in y_k +- e.
With z = T psi and y(k) = d'psi + theta'z (see `regressors`), every promise that is a linear program reads

    upper   (d + T'centre)'psi + radius'|T psi| >= top_k         lower   -(d + T'centre)'psi + radius'|T psi| >= -bottom_k

| type             | statement                                   | psi                  | top, bottom  |
|------------------|---------------------------------------------|----------------------|--------------|
| Overlap          | some y in [y], some theta                   | as measured          | y - e, y + e |
| InclusionExact   | all y in [y], some theta                    | as measured          | y + e, y - e |
| InclusionAll     | all psi in [psi], all y in [y], some theta  | all in psi_k +- r    | y + e, y - e |
| InclusionPaper   | some psi in [psi], all y in [y], some theta | outer product (7)    | y + e, y - e |

Only InclusionAll keeps the true system in the model when regressors carry errors. InclusionPaper is what [2] (8) writes: it
asks the outer bound (7) to be large, so that y may leave the true envelope. In both, parameters shrink towards 0 as errors grow.

[2] Linear time-varying models with interval parameters, section 4.
"""

import numpy as np

from workbench.errors import InputError
from workbench.intervals.regressors import Samples
from workbench.records import field, record


@record
class ParameterBox:
    """Parameters theta_i in centre_i +- radius_i, (p) each."""

    centre: np.ndarray = field("p")
    radius: np.ndarray = field("p", low=0.0)


class _Semantics:
    """regressor_radius (m) and ends (top (K), bottom (K)) of the table above."""

    name = ""
    promise = ""

    def regressor_radius(self, S: Samples) -> np.ndarray:
        return np.zeros(S.psi.shape[1])

    def ends(self, S: Samples) -> tuple[np.ndarray, np.ndarray]:
        return S.y + S.output_error, S.y - S.output_error


@record
class Overlap(_Semantics):
    """Envelope and measured interval have a point in common, at the regressors as measured."""

    name = "overlap"
    promise = "at every estimation sample the envelope and the measured value, give or take its error, have a point in common"

    def ends(self, S: Samples) -> tuple[np.ndarray, np.ndarray]:
        return S.y - S.output_error, S.y + S.output_error


@record
class InclusionExact(_Semantics):
    """The envelope holds the measured interval, at the regressors as measured."""

    name = "inclusion-exact"
    promise = (
        "at every estimation sample the envelope holds the measured value, give or take its error, at the regressors as measured"
    )


@record
class InclusionAll(_Semantics):
    """The envelope holds the measured interval for every regressor that the error bounds allow."""

    name = "inclusion-all"
    promise = (
        "at every estimation sample the envelope holds the true output, whatever the true values are within the error bounds"
    )

    def regressor_radius(self, S: Samples) -> np.ndarray:
        return S.error


@record
class InclusionPaper(_Semantics):
    """The paper's inclusion, with the outer product (7) at interval regressors: unsound, for comparison. Shift form only."""

    name = "inclusion-paper"
    promise = "the paper's inclusion; unsound where regressors carry errors, for comparison only"

    def regressor_radius(self, S: Samples) -> np.ndarray:
        if any(len(block) > 1 for block in S.form.blocks):
            raise InputError("the paper's inclusion in delta form", mend="use the shift form (delta=False) or another semantics")
        return S.error


Semantics = Overlap | InclusionExact | InclusionAll | InclusionPaper
SEMANTICS: dict[str, type] = {cls.name: cls for cls in (InclusionAll, InclusionExact, Overlap, InclusionPaper)}
