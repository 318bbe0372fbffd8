"""Plants: states, equations and ports, effects at the ports, the compiled step, and what a controller must be."""
