"""Records -> LPV model, one file or folder per method; METHODS names them for the command line."""

from workbench.identification.ilm import ILM
from workbench.identification.lti import LTI
from workbench.identification.output_error.method import OutputError
from workbench.identification.output_error.state_space import LPVOutputError
from workbench.identification.ssm import SSM

METHODS: dict[str, type] = {"lti": LTI, "ilm": ILM, "ssm": SSM, "oe": OutputError, "lpv-oe": LPVOutputError}
