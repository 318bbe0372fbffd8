"""Hammerstein-Wiener models: a static curve before each input of an LPV model, and sensors that show a size without its sign.

    v_i = f_i(u_i),   z = G(rho) v,   y_j = z_j,  or |z_j| of a sensor that is blind to the sign

f is piecewise linear through nodes. Thrust that grows as the square of a speed, the curve of a valve, a dead zone and the loss of
dry friction at rest are such curves; a pulse counter on a shaft that turns both ways is such a sensor.
"""

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from workbench.curves import Curve, check_single
from workbench.data import Channel, Experiment
from workbench.errors import InputError, check_known
from workbench.files import read_json, write_json
from workbench.lpv import LPVModel, load_model, model_from_dict
from workbench.records import field, record

if TYPE_CHECKING:
    import control

__all__ = ["Curve", "HammersteinWienerModel", "load_hammerstein"]

SCHEMA = "gain-scheduling-workbench/hammerstein-wiener-model"
VERSION = 1
SETTLED = 200  # passes along a record, after which its signs are taken as they are


@record
class HammersteinWienerModel:
    """An LPV model `core` of v = f(u), of which the sensors `unsigned` show |z|; scored and saved like every other model.

    curves: of some inputs, the others act as they are. Runs, predictions and `to_control` are in u and y.

        >>> curved = HammersteinWiener().fit(fan)
        >>> [c.input for c in curved.curves], curved.simulate(fan_held_out.experiments[0]).shape
        (['u'], (720, 1))
    """

    name: str
    core: LPVModel = field()
    curves: tuple[Curve, ...] = ()
    unsigned: tuple[str, ...] = ()
    noise: np.ndarray | None = None  # (ny, ny) covariance of the one-step prediction error
    trained_on: tuple[str, ...] = ()  # fingerprints of the estimation records
    notes: tuple[str, ...] = ()

    def __post_init__(self):
        check_single((own.input for own in self.curves), self.name)
        for curve in self.curves:
            check_known("input", curve.input, [c.name for c in self.core.inputs])
            if curve.input in [c.name for c in self.core.schedules]:
                mend = "take another schedule, or the input without a curve"
                raise InputError(
                    "a static curve of an input that is the schedule", file=self.name, channel=curve.input, mend=mend
                )
        for name in self.unsigned:
            check_known("output", name, [c.name for c in self.core.outputs])
        if self.core.scheduled_output is not None:
            mend = "take a schedule from outside, or none"
            raise InputError("static curves around a model whose schedule is its own output", file=self.name, mend=mend)

    @property
    def dt(self) -> float:
        return self.core.dt

    @property
    def inputs(self) -> tuple[Channel, ...]:
        return self.core.inputs

    @property
    def outputs(self) -> tuple[Channel, ...]:
        return self.core.outputs

    @property
    def schedules(self) -> tuple[Channel, ...]:
        return self.core.schedules

    @property
    def spans(self) -> np.ndarray:
        return self.core.spans

    @property
    def reach(self) -> float:
        return self.core.reach

    @property
    def order(self) -> int:
        return self.core.order

    @property
    def warmup(self) -> int:
        """Samples after which the predictor has forgotten its initial state: rows before that are never scored."""
        return self.core.warmup

    # ---- records as the core reads them --------------------------------------------------------------------------

    def curved(self, experiment: Experiment) -> Experiment:
        """The record with v in place of u."""
        return with_curves(experiment, self.curves)

    def signs_of(self, z: np.ndarray) -> np.ndarray:
        """Signs (N, unsigned) of what the core says of these outputs, z (N, ny); of 0 they are 1."""
        own = [[c.name for c in self.outputs].index(name) for name in self.unsigned]
        return np.where(z[:, own] < 0.0, -1.0, 1.0)

    def shown(self, z: np.ndarray) -> np.ndarray:
        """What the sensors show of z (N, ny)."""
        own = [c.name in self.unsigned for c in self.outputs]
        return np.where(own, np.abs(z), z)

    # ---- simulation and prediction -------------------------------------------------------------------------------

    def simulate(self, experiment: Experiment, *, warmup: int | None = None) -> np.ndarray:
        """Free run: the outputs (N, ny) from the measured inputs and schedule alone.

        Only the start is found on outputs, on the first `warmup` samples; default: the predictor's own memory.
        """
        return self.shown(self.run(experiment, warmup=warmup))

    def run(self, experiment: Experiment, *, warmup: int | None = None) -> np.ndarray:
        """The free run with its signs, z (N, ny); see `simulate`.

        The start is found on the first samples, to which no sensor gave a sign: of all signs that stay there, and those of a
        run from any start, that one counts under which the run errs least on them.
        """
        inner = self.curved(experiment)
        if not self.unsigned:
            return self.core.simulate(inner, warmup=warmup)
        names, N = [c.name for c in self.outputs], len(experiment)
        first = max(self.warmup if warmup is None else warmup, 1)
        scale = np.maximum(np.abs(experiment[names][:first]).max(axis=0), np.finfo(float).tiny)

        def missed(z: np.ndarray) -> float:
            with np.errstate(over="ignore", invalid="ignore"):
                error = float(np.sum(((self.shown(z) - experiment[names]) / scale)[:first] ** 2))
            return error if np.isfinite(error) else np.inf

        still = [np.tile(s, (N, 1)) for s in itertools.product((-1.0, 1.0), repeat=len(self.unsigned))]
        runs = [self.core.simulate(with_signs(inner, self.unsigned, s), warmup=warmup) for s in still]
        runs += [self.core.simulate(with_signs(inner, self.unsigned, self.signs_of(z)), warmup=warmup) for z in runs]
        return min(runs, key=missed)

    def predict(self, experiment: Experiment, steps: int = 1) -> np.ndarray:
        """y(k | k - steps), (N, ny); each measured size has the sign of what was predicted of it one step before."""
        inner = self.curved(experiment)
        if not self.unsigned:
            return self.core.predict(inner, steps)
        signs = self.signs_of(self.run(experiment))
        # the sign at k follows from those before k: where no sign changes any more, each is that of its own prediction
        for _ in range(SETTLED):
            before, signs = signs, self.signs_of(self.core.predict(with_signs(inner, self.unsigned, signs)))
            if np.array_equal(signs, before):
                break
        return self.shown(self.core.predict(with_signs(inner, self.unsigned, signs), steps))

    def to_control(self, rho: Any = None, *, u: Any = None) -> "control.StateSpace":
        """Small motions at a schedule value about inputs u (nu,), default those of the operating point there; of z where the
        sensor is blind to its sign.
        """
        about = None if u is None else np.ravel(u).astype(float)
        if about is not None and len(about) != len(self.inputs):
            raise InputError(
                f"{len(about)} inputs, the model has {len(self.inputs)}", file=self.name, mend="give one number for each"
            )
        system, slopes = self.core.to_control(rho), np.ones(len(self.inputs))
        point = self.core.operating_point
        v0 = (point.basis(np.asarray(self.core.middle if rho is None else rho, dtype=float)[None]) @ point.u)[0]
        for curve in self.curves:
            i = [c.name for c in self.inputs].index(curve.input)
            if about is None and not curve.rising:
                mend = "say about which inputs: to_control(rho, u=[..])"
                said = "the curve does not rise everywhere: its slope there is not known"
                raise InputError(said, channel=curve.input, mend=mend)
            slopes[i] = curve.slope(curve.inverse(v0[i]) if about is None else about[i])
        system.B, system.D = system.B * slopes, system.D * slopes
        return system

    # ---- files ---------------------------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, readable without the package: nodes of every curve, and the core as in its own file."""
        return {
            "schema": SCHEMA,
            "version": VERSION,
            "name": self.name,
            "curves": [curve.to_dict() for curve in self.curves],
            "unsigned": list(self.unsigned),
            "core": self.core.to_dict(),
            "noise": self.noise,
            "trained_on": list(self.trained_on),
            "notes": list(self.notes),
        }

    def save(self, path) -> None:
        """Write the model as JSON (schema and version inside)."""
        write_json(path, self.to_dict())


#: What runs freely and predicts: every model but the interval ones.
Model = LPVModel | HammersteinWienerModel


def core_of(model: Model) -> LPVModel:
    """What a loop sees of a model behind its curves; of an LPV model itself. Raises InputError for sensors without a sign."""
    if isinstance(model, LPVModel):
        return model
    if model.unsigned:
        mend = "give the loop a sensor that tells the direction"
        raise InputError(f"{', '.join(model.unsigned)} shows no sign: no loop is closed over it", file=model.name, mend=mend)
    return replace(model.core, name=f"{model.name} behind its curves") if model.curves else model.core


def curves_of(model: Model) -> tuple[Curve, ...]:
    """The curves of a model; none of an LPV model."""
    return () if isinstance(model, LPVModel) else model.curves


def inverted(model: Model) -> tuple[Curve, ...]:
    """The curves that a law inverts on a model; see `Curve.invertible`."""
    return tuple(_inverted(curve, model) for curve in curves_of(model))


def _inverted(curve: Curve, model: Model) -> Curve:
    try:
        return curve.invertible
    except InputError as reason:
        raise InputError(reason.problem, file=model.name, channel=reason.channel, mend=reason.mend) from None


def behind(law: Any, model: Model) -> tuple[Any, LPVModel]:
    """The law of v and the core of the model: the loop of both, as it is behind the curves.

    Raises InputError where the law does not invert the curves of the inputs that it commands, and no others.
    """
    core, own = core_of(model), {curve.input: curve for curve in law.curves} if hasattr(law, "inside") else {}
    known = {curve.input: _inverted(curve, model) for curve in curves_of(model) if curve.input in law.actuated}
    for name in dict.fromkeys([*known, *own]):
        mend = "give the model that it was designed on"
        if name not in own:
            said, mend = f"{law.name} knows nothing of the curve of {name}", "design a PID on this model: it inverts the curve"
        elif name not in known:
            said = f"{law.name} inverts a curve of {name}, the model has none"
        elif not _same(own[name], known[name]):
            said = f"{law.name} inverts another curve of {name} than the model has"
        else:
            continue
        raise InputError(said, file=model.name, channel=name, mend=mend)
    return (law.inside, core) if own else (law, core)


def _same(one: Curve, other: Curve) -> bool:
    """Whether two curves are one, to a billionth of their ranges."""
    pairs = ((one.u, other.u), (one.v, other.v))
    return len(one.u) == len(other.u) and all(np.allclose(a, b, rtol=0.0, atol=1e-9 * np.ptp(b)) for a, b in pairs)


def with_curves(experiment: Experiment, curves: Iterable[Curve]) -> Experiment:
    """The record with v in place of u for the inputs of these curves."""
    values = experiment.values.copy()
    for curve in curves:
        values[:, experiment.names.index(curve.input)] = curve(experiment[curve.input])
    return replace(experiment, values=values)


def with_signs(experiment: Experiment, unsigned: Sequence[str], signs: np.ndarray | float) -> Experiment:
    """The record with the sizes of the outputs `unsigned` times signs, (N, unsigned) or one for all."""
    values = experiment.values.copy()
    own = [experiment.names.index(name) for name in unsigned]
    values[:, own] = np.abs(values[:, own]) * signs
    return replace(experiment, values=values)


def load_either(path) -> Model:
    """The Hammerstein-Wiener model of a file that holds one, else its LPV model. Raises InputError for a file that is neither."""
    content = read_json(path)
    curved = isinstance(content, dict) and content.get("schema") == SCHEMA
    return load_hammerstein(path) if curved else load_model(path)


def load_hammerstein(path) -> HammersteinWienerModel:
    """Read a file written by `HammersteinWienerModel.save`. Raises InputError for a file that is none.

    >>> HammersteinWiener(nodes=(5,)).fit(fan).save("hammerstein.json")
    >>> load_hammerstein("hammerstein.json").curves[0].input
    'u'
    """
    content = read_json(path)
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise InputError("not a Hammerstein-Wiener model", file=path, mend=f"expected a JSON object with schema {SCHEMA!r}")
    if content.get("version") != VERSION:
        raise InputError(f"model version {content.get('version')}, this program reads {VERSION}", file=path)
    try:
        return HammersteinWienerModel(
            content["name"],
            model_from_dict(content["core"]),
            tuple(map(Curve.from_dict, content["curves"])),
            tuple(content["unsigned"]),
            None if content["noise"] is None else np.array(content["noise"]),
            tuple(content["trained_on"]),
            tuple(content["notes"]),
        )
    except KeyError as reason:
        raise InputError(f"field {reason.args[0]!r} is missing", file=path, mend="write the model again") from None
    except (TypeError, ValueError, OverflowError) as reason:
        raise InputError(f"malformed model: {reason}", file=path, mend="write the model again") from None
