"""A zoo of strangers: machines that the workbench has never seen, with laboratory habits, on which a diagnosis is measured.

Every file is one machine: its equations, written for this zoo and integrated by `bench`, and below them the plant that a user
of the workbench would write after docs/add-a-plant.md. The two share names, units and the numbers of the data sheet, nothing
else. The door is `draw` in case.py.
"""
