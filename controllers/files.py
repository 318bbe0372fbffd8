"""Controllers as files: plain JSON with a schema and a version, one kind a law."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from controllers import mpc, nmpc, scheduled_pid
from workbench.errors import InputError, check_known
from workbench.files import read_json, write_json
from workbench.physics.controller import SCHEMA, VERSION, content_of
from workbench.physics.plant import Plant

KINDS: dict[str, Any] = {scheduled_pid.KIND: scheduled_pid.ScheduledPID, mpc.KIND: mpc.MPC, nmpc.KIND: nmpc.NMPC}


def save_controller(controller: Any, path: str | Path) -> Path:
    """Write a controller of a listed kind as a JSON file, which `load_controller` reads; returns its path.

    Raises InputError for a law of another kind.

        >>> save_controller(law, "pid.json").name
        'pid.json'
    """
    return write_json(path, content_of(controller))


def load_controller(path: str | Path, find_plant: Callable[[str], Plant] | None = None) -> Any:
    """Read a file written by `save_controller`; what is missing or foreign is named.

    find_plant: gives the plant that a nonlinear MPC predicts with, from what its file calls it. Only such a file needs it.

        >>> load_controller(save_controller(law, "pid.json")).actuated
        ('U',)
    """
    return controller_of(read_json(path), path, find_plant)


def controller_of(content: Any, path: str | Path, find_plant: Callable[[str], Plant] | None = None) -> Any:
    """The controller that the content of a file makes; path: the file that holds it, for messages."""
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise InputError(
            "not a controller", file=path, mend=f"expected a JSON object with schema {SCHEMA!r}, as workbench design writes it"
        )
    if content.get("version") not in (VERSION, *scheduled_pid.VERSIONS):
        raise InputError(f"controller version {content.get('version')}, this program reads {VERSION}", file=path)
    kind = KINDS[check_known("kind of controller", str(content.get("kind", "")), KINDS, file=path)]
    try:
        return kind.from_dict(content, find_plant) if kind is nmpc.NMPC else kind.from_dict(content)
    except InputError as reason:
        raise InputError(reason.problem, file=path, channel=reason.channel, mend=reason.mend) from None
    except KeyError as reason:
        raise InputError(f"field {reason.args[0]!r} is missing", file=path, mend="design the controller again") from None
    except (TypeError, ValueError, AttributeError, IndexError, OverflowError) as reason:
        raise InputError(f"malformed controller: {reason}", file=path, mend="design the controller again") from None
