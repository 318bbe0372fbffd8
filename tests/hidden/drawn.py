"""What the three machines draw alike: parameters within tolerance, programmes of set-points, and the log."""

from collections.abc import Mapping, Sequence

import numpy as np

from workbench.data import Experiment
from workbench.errors import InputError
from workbench.physics.plant import Plant
from workbench.records import field, record


@record
class Programme:
    """What a run is asked to do: set-points or courses (N, n); a held-out one is another programme, never to learn from.

    open_loop: the signals are the commands themselves, and no loop follows them.
    """

    name: str
    signals: np.ndarray = field("N n")
    held_out: bool = False
    open_loop: bool = False


@record
class Outcome:
    """A record, and why nobody would have kept it ("" where it is sound)."""

    experiment: Experiment
    fault: str


def asked(
    name: str, references: Mapping[str, np.ndarray], set_points: Sequence[str] = (), commands: Sequence[str] = ()
) -> Programme:
    """The programme in which a machine follows `references`, (N,) by name: its set-points, or its commands in open loop.

    Raises InputError where they are neither: a machine runs with all of its set-points or with all of its commands.
    """
    for names, open_loop in ((set_points, False), (commands, True)):
        if names and set(names) == set(references):
            return Programme(name, np.column_stack([references[n] for n in names]), open_loop=open_loop)
    known = " or ".join(", ".join(names) for names in (set_points, commands) if names)
    raise InputError(f"the machine cannot follow {', '.join(references)}", file=name, mend=f"give {known}")


def within_tolerance(plant: Plant, random: np.random.Generator) -> dict[str, float]:
    """value (1 + tolerance e), e normal of deviation 1/2 and cut at +-1: the data sheet's range holds every machine."""
    e = np.clip(0.5 * random.standard_normal(len(plant.parameters)), -1.0, 1.0)
    return {p.name: float(p.value * (1.0 + p.tolerance * k)) for p, k in zip(plant.parameters, e, strict=True)}


def staircase(samples: int, levels: Sequence[float], rise: int) -> np.ndarray:
    """Levels of equal length (samples,), each reached by a straight line of `rise` samples."""
    length = samples / len(levels)
    k = np.arange(samples)
    which = np.minimum((k / length).astype(int), len(levels) - 1)
    level = np.asarray(levels, float)
    before = level[np.maximum(which - 1, 0)]
    return before + (level[which] - before) * np.minimum((k - which * length) / min(rise, length), 1.0)


def logged(
    plant: Plant, name: str, values: Mapping[str, np.ndarray], kept: Sequence[str], references: Mapping[str, str]
) -> Experiment:
    """The record a logger writes: the channels in `kept` with the plant's units and roles, and set-points {name: of what}."""
    channels = {c.name: c for c in (*plant.inputs, *plant.outputs)}
    by_role: dict[str, dict[str, np.ndarray]] = {"input": {}, "output": {}, "schedule": {}, "other": {}}
    for channel in kept:
        by_role[channels[channel].role][channel] = values[channel]
    return Experiment.from_arrays(
        name,
        plant.dt,
        inputs=by_role["input"],
        outputs=by_role["output"],
        schedule=by_role["schedule"],
        other=by_role["other"],
        references={key: values[key] for key in references},
        units={c: channels[c].unit for c in kept} | {key: channels[of].unit for key, of in references.items()},
    )
