"""The built-in methods: ours, other tools each by its own library, extensions of the boundary's motion, networks."""
