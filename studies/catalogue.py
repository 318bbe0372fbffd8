"""The command `effects`, and the pages docs/effects.md and docs/plants.md: catalogue and machines as their own records say.

python -m studies.catalogue      writes both pages again
"""

import inspect
from argparse import Namespace
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from plants import PLANTS
from studies.arguments import choose_plant
from workbench.files import write_json, write_text
from workbench.physics.effects import EFFECTS, effects_of
from workbench.physics.effects.effect import EffectParameter
from workbench.physics.plant import Plant

Say = Callable[[str], None]

DOCS = Path(__file__).parents[1] / "docs"


def run(options: Namespace, say: Say) -> int:
    """Say what can be missing: at every place of a plant, or of all machines."""
    shown = {plant.name: list(entries(plant)) for plant in _asked(options.plant)}
    for name, own in shown.items():
        say(f"{name}:")
        for entry in own:
            say(f"  {entry['effect']}: {', '.join(entry['parameters'])}")
            for line in (entry["sentence"], entry["equation"], entry["symbols"], f"told apart by: {entry['separates']}"):
                say(f"      {line}")
    if options.json:
        write_json(options.json, shown)
    return 0


def _asked(name: str | None) -> Iterable[Plant]:
    return [choose_plant(name).plant] if name else PLANTS.values()


def entries(plant: Plant) -> Iterator[dict[str, Any]]:
    """Every effect at every place of a plant, with its numbers and texts as they read there."""
    for port in plant.all_ports:
        for effect in plant.offered[port.family, port.place]:
            yield {
                "effect": f"{effect.id}@{port.place}",
                "parameters": [_number(port.fitted(p)) for p in effect.parameters],
                "sentence": effect.sentence.format(place=port.place),
                "equation": effect.stated,
                "symbols": port.symbols_of(effect),
                "separates": effect.separates,
            }


def _number(p: EffectParameter) -> str:
    unit = "" if p.unit == "1" else f" [{p.unit}]"
    return f"{p.name}{unit}{f' (usually {p.default:g})' if p.shape else ''}"


# ---- the pages -------------------------------------------------------------------------------------------------------------


def effects_page() -> str:
    """docs/effects.md."""
    text = [
        "# Effects: the catalogue of missing physics\n",
        "What `simulate` switches on with `--effect EFFECT@PLACE:NUMBER=VALUE`, and what `diagnose` looks for. A size of 0 is no",
        "effect; a shape (a width, a time constant) has a usual value. Positive sizes act as the equation says, with its signs.",
        "`workbench effects PLANT` says the same of one plant, in its units.\n",
        "```sh\nworkbench effects welding-robot\n```\n",
        "A law that is missing here is written in some 30 lines: [Add your own effect](add-an-effect.md).\n",
        "The texts are those of the effects' own records: `python -m studies.catalogue` writes this page.\n",
    ]
    for family in dict.fromkeys(effect.family for effect in EFFECTS.values()):
        text += _family(family)
    return "\n".join(text)


def _family(family: str) -> Iterator[str]:
    module = inspect.getmodule(effects_of(family)[0].law)
    ports = [port for port in vars(module).values() if isinstance(port, type) and getattr(port, "family", "") == family]
    about = (module.__doc__ or "").split(":")[0].split(".")[0].split(", in the order")[0]
    yield f"## {family.capitalize()}\n"
    yield f"{about}. Places: {_places(family)}.\n"
    plainest = min(ports, key=lambda port: len(port.__mro__))
    yield f"In the equations: {plainest.symbols}.\n"
    if len({port.symbols for port in ports}) > 1:
        yield "On what slides the same laws hold with a force for the torque, N for N m and m for rad.\n"
    for effect in effects_of(family):
        yield f"### {effect.id}\n"
        yield f"{effect.sentence.format(place='PLACE')}\n"
        yield f"- `{effect.stated}`"
        yield f"- numbers: {', '.join(_number(p) for p in effect.parameters)}"
        yield f"- told apart by: {effect.separates}\n"


def _places(family: str) -> str:
    by_plant = {plant.name: [q.place for q in plant.all_ports if q.family == family] for plant in PLANTS.values()}
    return "; ".join(f"{', '.join(places)} of {name}" for name, places in by_plant.items() if places) or "of your own plants"


def plants_page() -> str:
    """docs/plants.md."""
    text = [
        "# Plants: the machines of the workbench\n",
        "Equations, channels and parameters as the plants' own records say. A tolerance is what the data sheet leaves open, on",
        "either side: `diagnose` and `calibrate` take it as prior knowledge. `python -m studies.catalogue` writes this page; a",
        "machine of your own is described in [Add your own plant](add-a-plant.md), the effects in [Effects](effects.md).\n",
    ]
    for plant in PLANTS.values():
        text += _plant(plant)
    return "\n".join(text)


def _plant(plant: Plant) -> Iterator[str]:
    yield f"## {plant.name}\n"
    yield f"{inspect.getdoc(inspect.getmodule(plant.equation))}\n"
    yield f"One sample lasts {plant.dt:g} s.\n"
    roles = {c.name: f"input ({c.role})" if c.role == "schedule" else "input" for c in plant.inputs}
    roles |= {c.name: "output" for c in plant.outputs}
    channels = {c.name: c for c in (*plant.inputs, *plant.outputs, *plant.states)}
    states = set(plant.state_names)
    rows = [
        (name, c.unit, ", ".join([*([roles[name]] if name in roles else []), *(["state"] if name in states else [])]))
        for name, c in channels.items()
    ]
    yield from _table(("channel", "unit", "is", "meaning"), [(*row, plant.meaning.get(row[0], "")) for row in rows])
    yield from _table(
        ("parameter", "value", "unit", "tolerance", "meaning"),
        [(q.name, f"{q.value:.4g}", q.unit, f"{100 * q.tolerance:g} %", q.meaning) for q in plant.parameters],
    )
    places = dict.fromkeys(port.place for port in plant.all_ports)
    yield from _table(
        ("place", "meaning", "effects"),
        [(place, plant.meaning.get(place, ""), ", ".join(_offered(plant, place))) for place in places],
    )


def _offered(plant: Plant, place: str) -> Iterator[str]:
    for (_, at), own in plant.offered.items():
        if at == place:
            yield from (effect.id for effect in own)


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    for row in (header, ["---"] * len(header), *rows):
        yield f"| {' | '.join(row)} |"
    yield ""


PAGES = {"effects.md": effects_page, "plants.md": plants_page}


if __name__ == "__main__":
    for name, page in PAGES.items():
        write_text(DOCS / name, page())
