"""Are these records of this plant at all? What would be diagnosed as missing physics and is a slip of the hand is refused here.

First every channel by itself, then against a free run of the plant.
"""

from workbench.data import Dataset
from workbench.diagnosis.check.channels import check_channels, check_excitation, check_length, still_outputs, unlogged_channels
from workbench.diagnosis.check.comparison import comparison_notes
from workbench.diagnosis.check.headers import check_headers
from workbench.diagnosis.check.note import Note
from workbench.errors import InputError
from workbench.physics.plant import Plant
from workbench.units import check_units


def check(plant: Plant, dataset: Dataset, *, read: Dataset | None = None, anyway: bool = False) -> tuple[Note, ...]:
    """Refuse records that cannot be of `plant`, or from which nothing can be learned; what is merely odd is returned.

    Raises InputError for missing channels, units that are not the plant's (declared, or told by the size of a channel), records
    that are too short, outputs that stand still or at their stops, inputs that do not move, channels that have changed places,
    and records that the plant explains in no channel. read: the records before channels were converted by their headers, in which
    the plant must not follow them better. anyway: the user takes the records all the same; then all but missing channels,
    declared units and the sample time are notes.
    """
    units = {c.name: c.unit for c in (*plant.inputs, *plant.outputs)}
    for e in dataset:
        check_channels(plant, e)
        check_units(e, units)
        plant.sampled(e.dt, file=e.name)
    checks = [lambda: check_length(plant, dataset)]
    checks += [lambda a=a, b=b: check_headers(plant, a, b) or () for a, b in zip(read or (), dataset, strict=False)]
    for e in dataset:
        checks += [
            lambda e=e, one=one: one(plant, e) for one in (unlogged_channels, still_outputs, check_excitation, comparison_notes)
        ]
    notes: list[Note] = []
    for one in checks:
        try:
            notes += one()
        except InputError as reason:
            if not anyway:
                raise
            refused = reason.problem + (f" ({reason.mend})" if reason.mend else "")
            notes.append(Note(str(reason.file or plant.name), reason.channel or "", f"taken all the same: {refused}"))
    return tuple(notes)
