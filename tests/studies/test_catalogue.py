"""The pages of the catalogue are those of the records, and the command says the same in the units of a plant."""

import json

import pytest

from plants import PLANTS
from studies.catalogue import DOCS, PAGES, entries
from studies.cli import main
from workbench.data import Channel
from workbench.physics.effects import EFFECTS
from workbench.physics.parameters import Parameter
from workbench.physics.plant import Plant


@pytest.mark.parametrize("name", PAGES)
def test_the_page_in_the_docs_is_current(name):
    written = (DOCS / name).read_text(encoding="utf-8")
    assert written == PAGES[name](), "python -m studies.catalogue writes it again"


def test_the_page_of_effects_holds_every_effect_with_equation_cause_units_and_what_separates_it():
    page = PAGES["effects.md"]()
    for effect in EFFECTS.values():
        (own,) = [part for part in page.split("### ") if part.startswith(f"{effect.id}\n")]
        assert f"`{effect.stated}`" in own
        assert effect.sentence.format(place="PLACE") in own
        assert effect.separates in own
        for p in effect.parameters:
            assert f"{p.name} [{p.unit}]" in own or (p.unit == "1" and p.name in own)


def test_the_page_of_plants_explains_every_channel_place_and_parameter():
    page = PAGES["plants.md"]()
    for plant in PLANTS.values():
        own = page.split(f"## {plant.name}\n")[1].split("\n## ")[0]
        for q in plant.parameters:
            assert q.meaning, f"{plant.name}: {q.name}"
            assert f"| {q.name} | {q.value:.4g} | {q.unit} | {100 * q.tolerance:g} % | {q.meaning} |" in own
        names = {*plant.state_names, *plant.input_names, *plant.output_names, *(port.place for port in plant.ports)}
        assert set(plant.meaning) == names
        assert all(words and words in own for words in plant.meaning.values())


def test_the_command_lists_what_can_be_missing_in_the_units_of_the_plant(tmp_path, capsys):
    assert main(["effects", "welding-robot", "--json", str(tmp_path / "e.json")]) == 0
    said = capsys.readouterr().out
    assert "coulomb@rail: level [N], width [m/s] (usually 0.01)\n" in said
    assert "force = -level * tanh(v / width)" in said
    assert "torque" not in said.replace("torque-ripple@rail", "")
    assert "force: positive in the direction of positive speed; v: speed\n" in said  # no word of angle or load
    (content,) = json.loads((tmp_path / "e.json").read_text()).values()
    assert [e["effect"] for e in content] == list(dict.fromkeys(slot.key for slot in PLANTS["welding-robot"].slots))
    assert main(["effects"]) == 0
    every = capsys.readouterr().out
    assert all(f"{name}:\n" in every for name in PLANTS)


def test_a_plant_without_words_for_its_channels_is_listed_too():
    plant = Plant(
        "p", (Channel("x", "m"),), (Channel("u", "N", "input"),), (Channel("y", "m", "output"),), (Parameter("k", 1.0),),
        lambda x, u, p, at: {"x": p.k * u.u}, lambda x, p: {"y": x.x}, 0.01,
    )  # fmt: skip
    assert {e["effect"].split("@")[1] for e in entries(plant)} == {"u", "y"}
