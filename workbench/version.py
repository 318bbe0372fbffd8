"""The version: what provenance, `workbench --version` and the package say."""

__version__ = "0.1.0"
"""The version of the workbench, as `workbench --version` prints it.

    >>> f"written by workbench {__version__}"
    'written by workbench ...'
"""
