"""Guaranteed envelopes of a closed loop along a known run, and the parameter sequences that come near them."""
