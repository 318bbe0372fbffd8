"""Records with hidden effects, on which a diagnosis is measured; nothing here takes an equation from the workbench.

The machines are written a second time, as elongations and angles integrated at 0.25 to 1 ms, with missing physics of another
kind than the catalogue's where there is one: bristles for dry friction, the geometry of an eccentric reel, buffers, filters and
play on the fine grid. Only names, units, numbers of the data sheets and their tolerances are shared. The door is
`draw` in case.py.
"""
