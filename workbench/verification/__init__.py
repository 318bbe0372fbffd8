"""What is claimed of a loop, on the identified model and on the plant, each claim with its verdict and witness."""
