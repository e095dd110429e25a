"""Attacks on the entrance: broken files, and what else a program meets that does not wish it well."""
