"""A scheduled PID for other programs: the gain table."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from controllers.scheduled_pid import ScheduledPID
from workbench.data import Channel
from workbench.files import write_text
from workbench.lpv import PiecewiseLinear


def table_points(law: ScheduledPID, points: int = 21) -> np.ndarray:
    """Schedule values at which a table of the gains is complete: the knots, where linear interpolation is exact, else a grid."""
    if law.schedule is None:
        return np.zeros(1)
    return law.basis.knots if isinstance(law.basis, PiecewiseLinear) else np.linspace(law.span[0], law.span[1], points)


def write_gain_table(law: ScheduledPID, path: str | Path, channels: Sequence[Channel] = ()) -> Path:
    """CSV of Kp, Ki, Kd and u0 over the schedule, a column a number; units from `channels` where they are known.

    Between rows the gains are interpolated linearly, outside the table they hold the edge row.
    """
    unit = {c.name: c.unit for c in channels}
    header = [f"{law.schedule} [{unit.get(law.schedule, '')}]"] if law.schedule else []
    for name, time in (("Kp", ""), ("Ki", "/s"), ("Kd", " s")):
        for a in law.actuated:
            for m in law.measured:
                known = f" [{unit[a]}/({unit[m]}){time}]" if a in unit and m in unit else ""
                header.append(f"{name}_{a}_{m}{known}")
    header += [f"u0_{a}" + (f" [{unit[a]}]" if a in unit else "") for a in law.actuated]
    rows = [",".join(header)]
    for rho in table_points(law):
        numbers = [np.ravel(K) for K in law.gains_at(rho)]
        rows.append(",".join(repr(float(v)) for v in np.concatenate([[rho][: law.schedule is not None], *numbers])))
    return write_text(path, "\n".join(rows) + "\n")
