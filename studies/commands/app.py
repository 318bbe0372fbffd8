"""`workbench app`: the bench in the browser, on this machine alone."""

from argparse import Namespace
from datetime import datetime
from pathlib import Path

from studies.cli import DONE
from studies.terminal import say
from workbench.errors import InputError


def run(options: Namespace) -> int:
    """Serve the session's page until interrupted."""
    try:
        from studies.app.server import serve
    except ImportError:
        raise InputError("the app needs two more libraries", mend='pip install "gain-scheduling-workbench[app]"') from None
    folder = Path(options.folder or Path("runs") / f"app-{datetime.now():%Y%m%d-%H%M%S}")
    serve(folder, options.port, say, browser=not options.no_browser)
    return DONE
