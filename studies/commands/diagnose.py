"""`workbench diagnose`: what the simulation of a plant gets wrong on records, and the plant extended by what was found."""

from argparse import Namespace

from studies.arguments import choose_plant, run_folder
from studies.cli import DONE
from studies.commands.records import configuration, plant_again, read_both
from studies.experiments import templates_of
from studies.referee import handed_out
from studies.terminal import progress, say
from workbench.answers.answer import PLANT_FILE
from workbench.answers.diagnose import DIAGNOSIS_FILE, EXPERIMENT_FILE, diagnose
from workbench.files import write_bytes
from workbench.provenance import provenance


def run(options: Namespace) -> int:
    """Diagnose, say the verdict first, and write diagnosis.json, the plant file, the next experiment and the page."""
    chosen = choose_plant(options.plant)
    own, held_out = read_both(options)
    found = diagnose(
        chosen.plant, own, held_out, templates=templates_of(chosen.machine), dt=options.dt, anyway=options.anyway,
        accept=options.accept, progress=progress,
    )  # fmt: skip
    code = handed_out(found.objections, options.accept, say)
    for sentence in (*found.sentences, *(f"note: {note}" for note in found.notes)):
        say(sentence)
    progress("drawing")
    asked = configuration(options, found.records, "plant", "holdout", "anyway")
    source = provenance(asked, [*found.records.files, *chosen.files])
    folder = found.save(run_folder(options.out, "diagnose"), base=chosen.base, source=source)
    if (folder / EXPERIMENT_FILE).exists():
        say(f"next experiment: {folder / EXPERIMENT_FILE}")
    if options.json:
        write_bytes(options.json, (folder / DIAGNOSIS_FILE).read_bytes())
    if code == DONE:
        say(f"extended plant, for --plant and simulate: {plant_again(chosen, folder / PLANT_FILE)}")
    say(f"report: {folder / 'report.html'}")
    return code
