"""Loops on models with bounded errors: limits, margins, envelopes, certificates, worst machines and verdicts."""
