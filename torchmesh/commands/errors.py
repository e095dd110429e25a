"""Errors of the command line itself."""

import typer

# Typer contains click or imports it, depending on its version.  Either way these are click's own classes:
# UsageError for a wrong combination or value of arguments, and ClickException, the base of all such errors.
UsageError: type[Exception] = typer.BadParameter.__mro__[1]
ClickException: type[Exception] = typer.BadParameter.__mro__[2]
