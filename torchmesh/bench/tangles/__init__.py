"""The families of cases; each module has a tuple FAMILIES."""
