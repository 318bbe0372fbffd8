"""The version of the workbench: what provenance, `workbench --version` and the package say."""

__version__ = "0.1.0"
