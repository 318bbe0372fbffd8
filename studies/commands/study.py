"""`workbench study`: run a study and say where its report is."""

from argparse import Namespace
from inspect import signature

from studies.arguments import run_folder
from studies.terminal import progress, say
from workbench.errors import InputError, check_known


def run(options: Namespace) -> int:
    """Run a study and say where its report is."""
    from studies import STUDIES

    module = STUDIES[check_known("study", options.study, STUDIES)]()
    own = {name: value for name in ("cases", "jobs", "fresh") if (value := getattr(options, name)) is not None}
    if foreign := [name for name in own if name not in signature(module.main).parameters]:
        takers = [name for name, load in STUDIES.items() if foreign[0] in signature(load().main).parameters]
        raise InputError(f"--{foreign[0]} does not belong to {options.study}", mend=f"leave it out, or study {', '.join(takers)}")
    folder = run_folder(options.out, options.study)
    module.main(
        quick=options.quick,
        folder=folder,
        data=options.data,
        seed=options.seed,
        json=options.json,
        say=say,
        progress=progress,
        **own,
    )
    return 0
