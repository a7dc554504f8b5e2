"""Evaluation: error against time, stages against the machine's limits, maps that break samplers, other programs."""
