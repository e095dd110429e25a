"""How hard a tangle may be, and whether any input ends badly."""
