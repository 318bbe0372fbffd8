"""From records to a checked controller in Python: the same as the commands of README.md, with the same files."""

from plant import LOOP, PLANT

import workbench as wb
from controllers import ScheduledPIDDesign

data = wb.read("records/a.csv", "records/b.csv", "records/c.csv", inputs="U", outputs="n", schedule="way")
held = wb.read("records/held-out.csv", inputs="U", outputs="n", schedule="way")

found = wb.diagnose(PLANT, data, held)
print(found)
model = wb.identify(data, held, methods=["ssm"]).model
law = ScheduledPIDDesign(knots=3, setpoint={"n": 300.0}, low={"U": -12.0}, high={"U": 12.0}).on(model)
answer = wb.check(law, "limits.toml", model=model, records=data, plant=found.extension().of(LOOP), fitted=[found], runs=20)
print(answer)
answer.save("checked-in-python")
