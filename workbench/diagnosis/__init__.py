"""What a simulation lacks to explain records: search, fit, rivals, remainder, referee, and the answer; see `diagnosis`."""
