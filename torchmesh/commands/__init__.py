"""The command line, one module a command.

Imports from everything else; nothing imports from here.
"""
