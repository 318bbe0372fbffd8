"""Records -> LPV model, one file per method; METHODS names them for the command line."""

from workbench.identify.ilm import ILM
from workbench.identify.lti import LTI
from workbench.identify.ssm import SSM

METHODS: dict[str, type] = {"lti": LTI, "ilm": ILM, "ssm": SSM}
