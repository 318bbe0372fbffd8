"""`workbench doctor`: versions, threads, compiler cache, and a two-second self-check against a known answer."""

from argparse import Namespace

from studies.terminal import say
from workbench.files import write_json


def run(options: Namespace) -> int:
    """Versions, threads, compiler cache, and a two-second self-check against a known answer."""
    from studies.doctor import examine

    findings = examine()
    for finding in findings:
        say(f"{'ok  ' if finding.fine else 'FAIL'}  {finding.what}: {finding.found}")
        if not finding.fine:
            say(f"      mend: {finding.mend}")
    if options.json:
        write_json(options.json, {"findings": [vars(finding) for finding in findings]})
    return 0 if all(finding.fine for finding in findings) else 1
