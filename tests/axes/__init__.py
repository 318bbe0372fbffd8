"""Axes with an effect hidden in them: what a compensation must gain on."""
