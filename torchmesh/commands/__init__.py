"""The command line, with a module for each command.

Imports from everything else; nothing imports from here.
"""
