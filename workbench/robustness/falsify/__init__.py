"""Search for the worst machine within a box of parameters and effects, and the counterexample that it leaves."""
