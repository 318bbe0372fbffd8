"""Records -> model, one file or folder per method. METHODS names those of LPV models, CURVED one around such a model."""

from workbench.identification.hammerstein import HammersteinWiener
from workbench.identification.ilm import ILM
from workbench.identification.lti import LTI
from workbench.identification.output_error.method import OutputError
from workbench.identification.output_error.state_space import LPVOutputError
from workbench.identification.ssm import SSM

METHODS: dict[str, type] = {"lti": LTI, "ilm": ILM, "ssm": SSM, "oe": OutputError, "lpv-oe": LPVOutputError}
CURVED: dict[str, type] = {"hammerstein": HammersteinWiener}
